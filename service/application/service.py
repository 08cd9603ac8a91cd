"""Everything that can be asked of this product, in one place. Both faces call this and nothing else."""

from __future__ import annotations

import threading
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Self

from fastsplat.service.application.admin import Admin
from fastsplat.service.application.answers import Answers
from fastsplat.service.application.camera_files import camera_file
from fastsplat.service.application.open_scenes import OpenScenes
from fastsplat.service.application.paging import page_of, read_page_token, write_page_token
from fastsplat.service.application.quotas import Quotas
from fastsplat.service.application.resumable import ResumableUploads
from fastsplat.service.application.stored import label_of, operation_of, scene_of, summary_of
from fastsplat.service.application.uploads import UploadSession
from fastsplat.service.application.validate import check_page_size, check_request
from fastsplat.service.application.versions import Versions
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.types import ValidatedUpload
from fastsplat.service.settings import Settings
from fastsplat.service.store import Store, open_store
from fastsplat.service.store.blobs import remove
from fastsplat.service.store.codec import options_to_json
from fastsplat.service.store.records import NewJob, OperationRecord, SceneRecord
from fastsplat_contract.operations import Operation, OperationList, OperationState, SceneOptions
from fastsplat_contract.queries import Answer, CameraFormat, PictureRequest, QueryRequest
from fastsplat_contract.scenes import Edit, LabelList, ObjectList, Scene, SceneList, SceneVersion

Admit = Callable[[Path, CaptureSettings], ValidatedUpload]


class SceneService:
    """Scenes, operations and questions over one data folder. Synchronous; every method is safe from any thread.

    Raises nothing but `FastSplatError`s for anything a user can cause. Any number of these, in any number of
    processes, may share a data folder.
    """

    def __init__(self, store: Store, settings: Settings, admit: Admit | None = None) -> None:
        self._store = store
        self._settings = settings
        self._check_files = admit or _admit_upload
        self._admitting = threading.BoundedSemaphore(settings.capture.concurrent_validations)
        self._scenes = OpenScenes(store, settings)
        self._answers = Answers(store, settings, self._scenes)
        self._versions = Versions(store, settings, self._scenes)
        self._quotas = Quotas(store.quota_usage, settings.quotas)
        self.resumable = ResumableUploads(
            store.blobs, settings.capture.max_upload_bytes, settings.uploads.expiry_s, self._quotas
        )
        """Files that come in pieces, to be adopted by an upload once they are whole."""
        self.admin = Admin(store, settings, self._scenes.count)
        """What those who run the service ask of it."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of scenes and connections."""
        self._scenes.close()
        self._store.close()

    @property
    def heartbeat_s(self) -> float:
        """A standing question says that it lives after so long a silence, if it does not choose."""
        return self._settings.calls.heartbeat_s

    def new_upload(self, owner: str = "") -> UploadSession:
        """A place for the files of a new scene: `write` them, then `commit`; leaving it uncommitted removes all.

        Args:
            owner: the key whose quotas count.

        Raises:
            QuotaError: the key holds all that it may.
        """
        self._quotas.check_room(owner, 0)
        upload_id = _new_id()
        folder = self._store.blobs.upload(upload_id)
        return UploadSession(upload_id, folder, self._settings.capture, self._admit, owner)

    def get_operation(self, operation_id: str) -> Operation:
        """Where a job stands.

        Raises:
            NotFoundError: there is none of that id.
        """
        return operation_of(self._store.scenes.operation(operation_id))

    def cancel_operation(self, operation_id: str) -> Operation:
        """Ask a job to stop: a queued one is CANCELLED on return, a running one once its worker has looked again.

        A job that is over stays as it is. Returns the operation as it now stands.

        Raises:
            NotFoundError: there is none of that id.
        """
        record = self._store.scenes.cancel(operation_id)
        if record.state == "CANCELLED":
            self._store.blobs.drop_upload(record.upload_id)
        return operation_of(record)

    def list_operations(
        self, page_size: int = 0, page_token: str = "", state: OperationState | None = None
    ) -> OperationList:
        """Operations, newest first, in pages as `list_scenes`; only those in `state`, if given.

        Raises:
            InvalidInputError: a negative size, or a token that no page returned.
        """
        size = check_page_size(page_size, self._settings.store)
        records = self._store.scenes.list_operations(size + 1, read_page_token(page_token), state)
        return OperationList(tuple(operation_of(record) for record in records[:size]), _next(records, size))

    def get_scene(self, scene_id: str) -> Scene:
        """One scene with its dictionary, cameras and quality; of very many labels and cameras the first.

        Raises:
            NotFoundError: there is none of that id.
        """
        return scene_of(self._store.scenes.scene(scene_id), self._settings.calls.max_listed)

    def list_labels(self, scene_id: str, page_size: int = 0, page_token: str = "") -> LabelList:
        """A scene's dictionary by label id, in pages as `list_scenes`.

        Raises:
            NotFoundError: there is no such scene.
            InvalidInputError: a negative size, or a token that no page returned.
        """
        size = check_page_size(page_size, self._settings.store)
        scene = self._store.scenes.scene(scene_id)
        page, token = page_of(scene.dictionary, size, page_token, f"labels {scene_id} {scene.state}")
        return LabelList(tuple(label_of(row) for row in page), token)

    def list_objects(
        self, scene_id: str, version: str = "", label: str = "", page_size: int = 0, page_token: str = ""
    ) -> ObjectList:
        """The things of a scene as oriented boxes, in pages as `list_scenes`.

        Args:
            scene_id: which scene.
            version: of the scene; "" is the current one.
            label: only those of this dictionary entry, by its label or an alias; "" for all.
            page_size, page_token: as `list_scenes`.

        Returns:
            The page, the token of the next one ("" after the last), and the version that was read.

        Raises:
            NotFoundError: there is no such scene, version or label.
            NotReadyError, InvalidInputError: as `query` and `list_scenes`.
        """
        return self._answers.objects(scene_id, version, label, page_size, page_token)

    def camera_file(self, scene_id: str, file_format: CameraFormat) -> bytes:
        """The scene's own cameras as a file, see `service.application.camera_files`.

        Raises:
            NotFoundError, NotReadyError: as `query`.
            InvalidInputError: no such format, or one that cannot hold the cameras' names.
        """
        self._scenes.version(scene_id, "")
        return camera_file(scene_of(self._store.scenes.scene(scene_id)).cameras, file_format)

    def list_scenes(self, page_size: int = 0, page_token: str = "") -> SceneList:
        """Scenes, newest first, in pages; dictionary, cameras and quality are left to `get_scene`.

        Args:
            page_size: at most this many; 0 for the server's default, larger values than its limit are cut to it.
            page_token: "" for the first page, then what the page before returned.

        Returns:
            The page, and the token of the next one ("" after the last).

        Raises:
            InvalidInputError: a negative size, or a token that no page returned.
        """
        size = check_page_size(page_size, self._settings.store)
        records = self._store.scenes.list_scenes(size + 1, read_page_token(page_token))
        return SceneList(tuple(summary_of(record) for record in records[:size]), _next(records, size))

    def delete_scene(self, scene_id: str) -> None:
        """Forget a scene: its files go, its job stops, its request id is free again.

        Raises:
            NotFoundError: there is none of that id.
        """
        operation = self._store.scenes.delete_scene(scene_id)
        self._scenes.forget(scene_id)
        self._store.versions.forget(scene_id)
        self._store.blobs.drop_scene(scene_id)
        if operation.state != "RUNNING":  # otherwise its worker cleans up behind the trainer it kills
            self._store.blobs.drop_upload(operation.upload_id)
            remove(self._store.blobs.job(operation.id))
            remove(self._store.blobs.log(operation.id))

    def edit_scene(self, scene_id: str, edits: Sequence[Edit], request_id: str = "") -> SceneVersion:
        """Make a new version of a scene: the edits in order, all or none; the version is durable and current on return.

        Questions that are being answered keep the version they began with.

        Args:
            scene_id: which scene.
            edits: at least one.
            request_id: the same id with the same edits returns the version that they made; "" for none.

        Raises:
            NotFoundError: there is no such scene, label or object.
            NotReadyError: its training has not finished, or has failed.
            InvalidInputError: an edit that makes no sense.
            LimitExceededError: too many edits, or versions.
            ConflictError: the request id was used before for other edits.
        """
        return self._versions.edit(scene_id, edits, request_id)

    def undo_edit(self, scene_id: str, version: str = "") -> SceneVersion:
        """Go back to the version before the current one; returns it.

        Args:
            scene_id: which scene.
            version: undo only if this is the current version, so that a retry undoes once; "" undoes whatever it is.

        Raises:
            NotFoundError, NotReadyError: as `edit_scene`.
            ConflictError: there is nothing to undo, or another version is current.
        """
        return self._versions.undo(scene_id, version)

    def list_versions(self, scene_id: str) -> tuple[SceneVersion, ...]:
        """Every version of a scene, oldest first.

        Raises:
            NotFoundError, NotReadyError: as `edit_scene`.
        """
        return self._versions.all(scene_id)

    def current_version(self, scene_id: str) -> str:
        """The version that a question would read now.

        Raises:
            NotFoundError, NotReadyError: as `query`.
        """
        return self._scenes.version(scene_id, "")

    def query(self, request: QueryRequest) -> tuple[Answer, ...]:
        """Ask one scene, one answer a text, in order; or, if the request names none, every READY scene, newest first.

        Cameras, views and versions belong to one scene.

        Raises:
            NotFoundError: unknown scene, version or view.
            NotReadyError: the scene's training has not finished, or has failed.
            InvalidInputError: an empty text, or "mask2d" without a camera or view.
            LimitExceededError: too many or too long texts, too many or too large cameras.
            ModelUnavailableError: the scene's text encoder is not in the model directory.
            CancelledError: nobody waits for the answer any more.
        """
        return self._answers.query(request)

    def view_picture(self, request: PictureRequest) -> bytes:
        """One view of a scene as a picture, or as an array file.

        Raises:
            NotFoundError, NotReadyError, InvalidInputError, LimitExceededError: as `query`.
        """
        return self._answers.picture(request)

    def scene_ply(self, scene_id: str, version: str = "") -> tuple[Path, str]:
        """The whole scene as a standard 3DGS PLY file, and its version; never changes once there, gone with the scene.

        Raises:
            NotFoundError, NotReadyError: as `query`.
        """
        return self._answers.scene_ply(scene_id, version)

    def mask_ply(self, scene_id: str, text: str, version: str = "") -> bytes:
        """Just the Gaussians that answer `text`, as a standard 3DGS PLY; no rows when the answer is "absent".

        Raises:
            NotFoundError, NotReadyError, InvalidInputError, LimitExceededError: as `query`.
        """
        return self._answers.mask_ply(scene_id, text, version)

    def _admit(self, upload: UploadSession, name: str, request_id: str, options: SceneOptions) -> Operation:
        check_request(name, request_id, options, self._settings.store)
        digest = upload.digest(name, options)
        earlier = self._store.scenes.find_request(request_id, digest)
        if earlier is not None:
            remove(upload.folder)
            return operation_of(earlier)
        with self._admitting:
            admitted = self._check_files(upload.raw, self._settings.capture).folder
        if admitted != upload.raw:  # unpacked or laid out anew: what was sent is not needed any more
            admitted = admitted.rename(upload.folder / admitted.name)
            remove(upload.raw)
        self._store.blobs.keep_upload(upload.id)
        job = NewJob(
            scene_id=_new_id(),
            operation_id=_new_id(),
            name=name,
            request_id=request_id,
            request_digest=digest,
            upload_id=upload.id,
            options={"admitted": str(admitted.relative_to(upload.folder)), **options_to_json(options)},
            priority=options.priority,
        )
        record, new = self._store.scenes.create(
            job, lambda connection: self._quotas.reserve(connection, upload.owner, job.scene_id, upload.bytes)
        )
        if not new:
            self._store.blobs.drop_upload(upload.id)
        return operation_of(record)


def open_service(settings: Settings, admit: Admit | None = None) -> SceneService:
    """The service over `settings.data_dir`; `close` it when done.

    Args:
        settings: the operator's.
        admit: what checks an upload before it is acknowledged; by default `validate_in_sandbox`.

    Raises:
        InvalidInputError: the database URL cannot be read.
        ResourceError: the data folder or the database cannot be used.
    """
    return SceneService(open_store(settings.data_dir, settings.database_url, settings.artefacts), settings, admit)


def _admit_upload(folder: Path, settings: CaptureSettings) -> ValidatedUpload:
    from fastsplat.service.capture.sandbox import (
        validate_in_sandbox,  # loads with the first upload, not with the server
    )

    return validate_in_sandbox(folder, settings)


def _next(records: Sequence[SceneRecord] | Sequence[OperationRecord], size: int) -> str:
    """The token of the page after the first `size` records; "" if there are no more."""
    return write_page_token(records[size - 1].created_at, records[size - 1].id) if len(records) > size else ""


def _new_id() -> str:
    return uuid.uuid4().hex
