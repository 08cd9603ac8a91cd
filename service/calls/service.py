"""Everything that can be asked of this product, in one place. Both faces call this and nothing else."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Literal, Self

from service.calls.answers import Answers
from service.calls.paging import read_page_token, write_page_token
from service.calls.translate import operation_of, scene_of
from service.calls.types import Operation, QueryAnswer, QueryRequest, SceneInfo, SceneOptions
from service.calls.uploads import UploadSession
from service.calls.validate import check_page_size, check_request
from service.capture.settings import CaptureSettings
from service.capture.types import AdmittedUpload
from service.common.camera import PosedCamera
from service.settings import Settings
from service.store import Store, open_store
from service.store.blobs import remove, sync_tree
from service.store.records import NewJob

Admit = Callable[[Path, CaptureSettings], AdmittedUpload]
Output = Literal["mask2d", "mask3d"]
PictureKind = Literal["rgb", "overlay", "relevancy", "mask"]


class SceneService:
    """Scenes, operations and questions over one data folder. Synchronous; every method is safe from any thread.

    Raises nothing but `FastSplatError`s for anything a user can cause. Any number of these, in any number of
    processes, may share a data folder.
    """

    def __init__(self, store: Store, settings: Settings, admit: Admit | None = None) -> None:
        self._store = store
        self._settings = settings
        self._check_files = admit or _admit_upload
        self._answers = Answers(store, settings)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of scenes and connections."""
        self._answers.close()
        self._store.close()

    def new_upload(self) -> UploadSession:
        """A place for the files of a new scene: `write` them, then `commit`; leaving it uncommitted removes all."""
        upload_id = _new_id()
        return UploadSession(upload_id, self._store.blobs.upload(upload_id), self._settings.capture, self._admit)

    def get_operation(self, operation_id: str) -> Operation:
        """Where a job stands.

        Raises:
            NotFoundError: there is none of that id.
        """
        return operation_of(self._store.rows.operation(operation_id))

    def cancel_operation(self, operation_id: str) -> Operation:
        """Ask a job to stop: a queued one is CANCELLED on return, a running one within two seconds.

        A job that is over stays as it is. Returns the operation as it now stands.

        Raises:
            NotFoundError: there is none of that id.
        """
        record = self._store.rows.cancel(operation_id)
        if record.state == "CANCELLED":
            remove(self._store.blobs.upload(record.upload_id))
        return operation_of(record)

    def get_scene(self, scene_id: str) -> SceneInfo:
        """One scene with its dictionary, cameras and quality.

        Raises:
            NotFoundError: there is none of that id.
        """
        return scene_of(self._store.rows.scene(scene_id))

    def list_scenes(self, page_size: int = 0, page_token: str = "") -> tuple[tuple[SceneInfo, ...], str]:
        """Scenes, newest first, in pages; `cameras` are left to `get_scene`.

        Args:
            page_size: at most this many; 0 for the server's default, larger values than its limit are cut to it.
            page_token: "" for the first page, then what the page before returned.

        Returns:
            The page, and the token of the next one ("" after the last).

        Raises:
            InvalidInputError: a negative size, or a token that no page returned.
        """
        size = check_page_size(page_size, self._settings.store)
        found = self._store.rows.scenes(size + 1, read_page_token(page_token))
        page = tuple(scene_of(record) for record in found[:size])
        token = write_page_token(found[size - 1].created_at, found[size - 1].id) if len(found) > size else ""
        return page, token

    def delete_scene(self, scene_id: str) -> None:
        """Forget a scene: its files go, its job stops, its request id is free again.

        Raises:
            NotFoundError: there is none of that id.
        """
        operation = self._store.rows.delete_scene(scene_id)
        self._answers.forget(scene_id)
        remove(self._store.blobs.scene(scene_id))
        if operation.state != "RUNNING":  # otherwise its worker cleans up behind the trainer it kills
            remove(self._store.blobs.upload(operation.upload_id))
            remove(self._store.blobs.job(operation.id))
            remove(self._store.blobs.log(operation.id))

    def query(self, request: QueryRequest) -> tuple[QueryAnswer, ...]:
        """Ask one scene; one answer a text, in order.

        Raises:
            NotFoundError: unknown scene or view.
            NotReadyError: the scene's training has not finished, or has failed.
            InvalidInputError: an empty text, or "mask2d" without a camera or view.
            LimitExceededError: too many or too long texts, too many or too large cameras.
            ModelUnavailableError: the scene's text encoder is not in the model directory.
        """
        return self._answers.query(request)

    def query_all(self, texts: Sequence[str], outputs: Iterable[Output] = ()) -> tuple[QueryAnswer, ...]:
        """Ask every READY scene, newest first; answers in order of scenes, then texts.

        Cameras belong to one scene, so only "mask3d" can be asked for here.

        Raises:
            InvalidInputError: an empty text, or "mask2d" among the outputs.
            LimitExceededError: too many or too long texts.
        """
        return self._answers.query_all(tuple(texts), frozenset(outputs))

    def view_picture(
        self,
        scene_id: str,
        text: str | None,
        kind: PictureKind,
        camera: PosedCamera | None = None,
        view: str | None = None,
    ) -> bytes:
        """PNG bytes of one view of a scene.

        Args:
            scene_id: which scene.
            text: the question behind "overlay", "relevancy" and "mask"; not needed for "rgb".
            kind: the rendered view, the mask laid over it, turbo relevancy, or the mask alone (8-bit, 0/255).
            camera: a free viewpoint, or
            view: the name of one of the scene's own cameras; exactly one of the two.

        Raises:
            NotFoundError, NotReadyError, InvalidInputError, LimitExceededError: as `query`.
        """
        return self._answers.picture(scene_id, text, kind, camera, view)

    def scene_ply(self, scene_id: str) -> Path:
        """The whole scene as a standard 3DGS PLY file; never changes once there, gone when the scene is deleted.

        Raises:
            NotFoundError, NotReadyError: as `query`.
        """
        return self._answers.scene_ply(scene_id)

    def mask_ply(self, scene_id: str, text: str) -> bytes:
        """Just the Gaussians that answer `text`, as a standard 3DGS PLY; no rows when the answer is "absent".

        Raises:
            NotFoundError, NotReadyError, InvalidInputError, LimitExceededError: as `query`.
        """
        return self._answers.mask_ply(scene_id, text)

    def _admit(self, upload: UploadSession, name: str, request_id: str, options: SceneOptions) -> Operation:
        check_request(name, request_id, options, self._settings.store)
        digest = upload.digest(name, options)
        earlier = self._store.rows.find_request(request_id, digest)
        if earlier is not None:
            remove(upload.folder)
            return operation_of(earlier)
        admitted = self._check_files(upload.raw, self._settings.capture).folder
        if admitted != upload.raw:  # unpacked or laid out anew: what was sent is not needed any more
            admitted = admitted.rename(upload.folder / admitted.name)
            remove(upload.raw)
        sync_tree(upload.folder)
        job = NewJob(
            scene_id=_new_id(),
            operation_id=_new_id(),
            name=name,
            request_id=request_id,
            request_digest=digest,
            upload_id=upload.id,
            options={
                "admitted": str(admitted.relative_to(upload.folder)),
                "labels": list(options.labels),
                "time_budget_s": options.time_budget_s,
                "max_gaussians": options.max_gaussians,
            },
        )
        record, new = self._store.rows.admit(job)
        if not new:
            remove(upload.folder)
        return operation_of(record)


def open_service(settings: Settings, admit: Admit | None = None) -> SceneService:
    """The service over `settings.data_dir`; `close` it when done.

    Args:
        settings: the operator's.
        admit: what checks an upload before it is acknowledged; by default `service.capture.admit_upload`.

    Raises:
        InvalidInputError: the database URL cannot be read.
        ResourceError: the data folder or the database cannot be used.
    """
    return SceneService(open_store(settings.data_dir, settings.database_url), settings, admit)


def _admit_upload(folder: Path, settings: CaptureSettings) -> AdmittedUpload:
    from service.capture import admit_upload  # image codecs load with the first upload, not with the server

    return admit_upload(folder, settings)


def _new_id() -> str:
    return uuid.uuid4().hex
