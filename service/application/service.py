"""The service layer: all calls in one place. Both transports call this and nothing else."""

from __future__ import annotations

import copy
import time
import uuid
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Self

from sqlalchemy import Connection

from fastsplat.service.application.admin.admin import Admin
from fastsplat.service.application.admin.project_keys import ProjectKeys, check_unused
from fastsplat.service.application.admin.project_names import KnownNames
from fastsplat.service.application.admin.quotas import Quotas
from fastsplat.service.application.admin.server_capabilities import server_status
from fastsplat.service.application.answering.answers import Answers
from fastsplat.service.application.answering.detection_lists import Detections
from fastsplat.service.application.answering.localizing import Localizing
from fastsplat.service.application.answering.open_scenes import OpenScenes
from fastsplat.service.application.answering.photos import Photos, photo_page
from fastsplat.service.application.answering.thing_sheets import ThingSheets
from fastsplat.service.application.base.memory import MemoryBudget, machine_bytes
from fastsplat.service.application.base.paging import page_of, read_page_token, write_page_token
from fastsplat.service.application.base.validate import (
    admit_upload,
    check_labels,
    check_page_size,
    check_request,
    check_scene_name,
    check_splat_options,
)
from fastsplat.service.application.editing.observing import Observations
from fastsplat.service.application.editing.prompted_edits import PromptedEdits
from fastsplat.service.application.editing.versions import Versions
from fastsplat.service.application.exporting.scene_exports import Exports
from fastsplat.service.application.jobs.estimates import JobEstimates
from fastsplat.service.application.jobs.look_again_orders import look_again_job
from fastsplat.service.application.jobs.namer_orders import OwnNamer
from fastsplat.service.application.jobs.retries import retry
from fastsplat.service.application.jobs.running_jobs import RunningJobs
from fastsplat.service.application.jobs.scene_orders import place_order
from fastsplat.service.application.jobs.stored import labels_of, left_out_to_json, scene_of, summaries_of
from fastsplat.service.application.uploading.resumable import ResumableUploads
from fastsplat.service.application.uploading.sample_copies import copy_sample
from fastsplat.service.application.uploading.uploads import UploadSession
from fastsplat.service.application.uploading.validation_slots import ValidationSlots
from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.jobs.needed_models import check_models
from fastsplat.service.settings import Settings
from fastsplat.service.store.blobs.blobs import remove
from fastsplat.service.store.blobs.reserve import check_free_space
from fastsplat.service.store.rows.codec import options_to_json
from fastsplat.service.store.rows.records import DEFAULT_PROJECT, NewJob, OperationRecord, SceneRecord
from fastsplat.service.store.store import Store, open_store
from fastsplat_contract.jobs.look_again import LookAgainIn
from fastsplat_contract.jobs.operations import Operation, OperationList, OperationState, SceneOptions
from fastsplat_contract.messages.scenes import LabelList, Scene, SceneList, SceneUpdate
from fastsplat_contract.photos.photo_verdicts import PhotoVerdictList
from fastsplat_contract.server.keys import Role
from fastsplat_contract.server.server_status import ServerStatus

MAX_LISTED = 5_000
"""Labels and cameras of a scene that are told in one piece."""

Admit = Callable[[Path, CaptureSettings, bool], ValidatedUpload]


class SceneService:
    """Scenes, operations and questions of one project. Synchronous; every method is safe from any thread.

    What is another project's does not exist here; see `in_project`. It begins in the default project.
    Raises nothing but `FastSplatError`s for anything a user can cause. Any number of these, in any number of
    processes, may share a data folder.
    """

    def __init__(self, store: Store, settings: Settings, admit: Admit | None = None) -> None:
        self._settings = settings
        self._check_files = admit or admit_upload
        self._validating = ValidationSlots()
        self._memory = MemoryBudget(settings.calls, machine_bytes())
        self._prompted = PromptedEdits(settings, self._memory)
        self._quotas = Quotas(store.quota_usage, settings.quotas)
        self.estimates = JobEstimates(settings)
        """How long jobs would take."""
        files = settings.uploads
        self.resumable = ResumableUploads(
            store.blobs, settings.capture.max_upload_bytes, files.expiry_s, self._quotas, files.min_free_bytes
        )
        """Files that come in pieces, to be adopted by an upload once they are whole."""
        mine = store.in_project(DEFAULT_PROJECT)
        scenes = OpenScenes(mine, settings, self._memory)
        self.known_names = KnownNames(mine, settings)
        self.exports = Exports(mine, scenes, self._memory)
        self.localizing = Localizing(mine, settings, scenes, self._memory)
        self.admin = Admin(store, settings, scenes.count)
        """What those who run the service ask of it."""
        self._bind(DEFAULT_PROJECT, mine, scenes)

    def _bind(self, project: str, store: Store, scenes: OpenScenes) -> None:
        """Make each part that belongs to one project; what keeps something open over projects is there already."""
        settings, memory = self._settings, self._memory
        self.project, self._store, self._scenes = project, store, scenes
        self.answers = Answers(store, settings, scenes, memory, self.known_names)
        """Questions, pictures and files of finished scenes."""
        self.detections = Detections(settings, scenes, self.known_names)
        self.versions = Versions(store, settings, scenes, memory, self._prompted)
        self.photos = Photos(store, settings, scenes, memory, self.known_names)
        """Photos of finished scenes, and which cameras show a thing best."""
        self.sheets = ThingSheets(store, settings, scenes, memory, self.known_names)
        self.namer = OwnNamer(store, settings, scenes, self._quotas, project)
        self.observations = Observations(store, settings, scenes, memory, self.localizing, self.versions)
        self.keys = ProjectKeys(store, settings, project)
        self.jobs = RunningJobs(store, settings)
        """What jobs show of their scenes while they run."""

    def in_project(self, project: str, scene_id: str = "") -> SceneService:
        """This service as another project has it; with `scene_id`, as if that were the project's one scene. Threads,
        open scenes and limits are shared, so close one of them."""
        if (project, scene_id) == (self.project, self._store.only_scene):
            return self
        other = copy.copy(self)
        store = self._store.in_project(project, scene_id)
        scenes = self._scenes.over(store)
        other.known_names = self.known_names.over(store)
        other.exports = self.exports.over(store, scenes)
        other.localizing = self.localizing.over(store, scenes)
        other._bind(project, store, scenes)
        return other

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of scenes and connections."""
        self.localizing.close()
        self._scenes.close()
        self._store.close()

    @property
    def heartbeat_s(self) -> float:
        """A standing question says that it lives after so long a silence, if it does not choose."""
        return self._settings.calls.heartbeat_s

    def new_upload(self) -> UploadSession:
        """A place for the files of a new scene: `write` them, then `commit`; leaving it uncommitted removes all.

        Raises:
            QuotaError: the project holds all that it may.
            ResourceError: the disk is almost full.
        """
        self._quotas.check_room(self.project, 0)
        check_space = partial(check_free_space, self._store.blobs.root, self._settings.uploads.min_free_bytes)
        check_space()
        upload_id = uuid.uuid4().hex
        return UploadSession(upload_id, self._store.blobs.upload(upload_id), self._settings.capture, check_space)

    def create_scene(
        self, upload: UploadSession, name: str, request_id: str, options: SceneOptions, upload_key: str = ""
    ) -> Operation:
        """Check what came, and queue its job. Durable once this returns; the upload is over either way.

        Args:
            upload: the files, see `new_upload`.
            name: the scene's name for people; may be empty.
            request_id: the same id with the same content returns the same operation; "" for none.
            options: see `SceneOptions`.
            upload_key: id of the key for one upload that this uses up; "" for none.

        Raises:
            ConflictError: the request id was used before for other content, or the key has made a scene before.
            InvalidInputError: names to look for that the configured detectors cannot know, where no label maps came.
            ModelUnavailableError: a model that the job would open is missing; or people or movers are to be withheld,
                and no configured detector knows them.
            FastSplatError: the files are refused by `validate_upload`; nothing is left.
        """
        with upload.committing():
            check_request(name, request_id, options, self._settings.store)
            digest = upload.digest(name, options)
            earlier = self._store.scenes.find_request(request_id, digest, self.project)
            if earlier is not None:
                remove(upload.folder)
                return self.jobs.operation(earlier)
            with self._validating.taken(self.project):
                validated = self._check_files(upload.raw, self._settings.capture, options.strict)
                upload.check_names(validated.source, validated.has_labels)
                check_labels(options, validated, self._settings)
            check_models(self._settings, given_labels=validated.has_labels, named=bool(options.labels))
            check_splat_options(validated, options)
            predicted = self.estimates.predicted(validated, options)
            upload.replace_files(validated.folder)
            self._store.blobs.keep_upload(upload.id)
            check_cancelled()  # from here on the scene is made, whether or not somebody still waits to hear of it
            job = NewJob(
                scene_id=uuid.uuid4().hex,
                operation_id=uuid.uuid4().hex,
                name=name,
                request_id=request_id,
                request_digest=digest,
                upload_id=upload.id,
                options={
                    "validated": upload.raw.name,
                    **left_out_to_json(validated),
                    **options_to_json(options),
                    **predicted,
                },
                priority=options.priority,
                project=self.project,
            )

            def within(connection: Connection) -> None:
                self._quotas.reserve(connection, self.project, job.scene_id, upload.bytes)
                if upload_key:
                    check_unused(connection, upload_key, job.operation_id)

            record, new = self._store.scenes.create(job, within)
            if not new:
                self._store.blobs.drop_upload(upload.id)
            return self.jobs.operation(record)

    def open_sample(self) -> Scene:
        """The project's copy of the sample scene, made where there is none. Errors as `copy_sample`."""
        return self.get_scene(copy_sample(self._store, self._quotas, self.project))

    @property
    def max_entries(self) -> int:
        """Files of an upload at most."""
        return self._settings.capture.max_entries

    def status(self, role: Role, key_id: str) -> ServerStatus:
        """What this server can do, and how much room the project has left, as a caller of this role may know it."""
        return server_status(self._store, self._settings, self.project, role, key_id)

    def look_again(self, scene_id: str, request: LookAgainIn) -> Operation:
        """Queue a job that searches a finished scene for more names. Durable once this returns.

        Raises:
            NotFoundError, NotReadyError: there is no such scene, or it is not ready.
            ModelUnavailableError, InvalidInputError, LimitExceededError: as `look_again_job`.
            ConflictError, QuotaError: as `place_order`.
        """
        self._scenes.finished(scene_id)
        job = look_again_job(scene_id, request, self.project, self._settings)
        return self.jobs.operation(place_order(job, self._store, self._quotas))

    def get_operation(self, operation_id: str) -> Operation:
        """Where a job stands. Raises `NotFoundError`: there is none of that id."""
        return self.jobs.operation(self._store.scenes.operation(operation_id))

    def cancel_operation(self, operation_id: str) -> Operation:
        """Ask a job to stop: a queued one is CANCELLED on return, a running one once its worker has looked again.

        A job that is over stays as it is. Returns the operation as it now stands.

        Raises:
            NotFoundError: there is none of that id.
        """
        record = self._store.reserve.lend(lambda: self._store.scenes.cancel(operation_id))
        if record.state == "CANCELLED" and record.options.get("privacy"):
            self._store.blobs.drop_upload(record.upload_id)
        return self.jobs.operation(record)

    def retry_operation(self, operation_id: str, exclude: Sequence[str] = ()) -> Operation:
        """Queue a failed or cancelled job again, with the upload that it had, or without some of its photos.

        Its scene is TRAINING again. Returns the operation as it now stands. Errors as `retries.retry`.
        """
        retention_s = self._settings.uploads.failed_retention_s
        record = retry(operation_id, exclude, self._store, self._quotas, self.project, retention_s)
        return self.jobs.operation(record)

    def list_operations(
        self, page_size: int = 0, page_token: str = "", state: OperationState | None = None
    ) -> OperationList:
        """Operations, newest first, in pages as `list_scenes`; only those in `state`, if given.

        Raises:
            InvalidInputError: a negative size, or a token that no page returned.
        """
        size = check_page_size(page_size, self._settings.store)
        records = self._store.scenes.list_operations(size + 1, read_page_token(page_token), state)
        return OperationList(self.jobs.operations(records[:size]), _next(records, size))

    def get_scene(self, scene_id: str) -> Scene:
        """One scene with its dictionary, cameras and quality; of very many labels and cameras the first.

        Raises:
            NotFoundError: there is none of that id.
        """
        return scene_of(self._store.scenes.scene(scene_id), MAX_LISTED)

    def update_scene(self, scene_id: str, update: SceneUpdate) -> Scene:
        """Rename a scene, in whatever state it is. Returns it as `get_scene`.

        Raises:
            NotFoundError: there is none of that id.
            InvalidInputError, LimitExceededError: a name that no scene may have.
            ConflictError: its name is not the expected one.
        """
        check_scene_name(update.name)
        self._store.scenes.rename(scene_id, update.name, update.expected_name)
        return self.get_scene(scene_id)

    def list_labels(self, scene_id: str, page_size: int = 0, page_token: str = "") -> LabelList:
        """A scene's dictionary by label id, in pages as `list_scenes`.

        Raises:
            NotFoundError: there is no such scene.
            InvalidInputError: a negative size, or a token that no page returned.
        """
        size = check_page_size(page_size, self._settings.store)
        scene = self._store.scenes.scene(scene_id)
        page, token = page_of(scene.dictionary, size, page_token, f"labels {scene_id} {scene.state}")
        return LabelList(labels_of(scene, page), token)

    def list_photo_verdicts(self, scene_id: str, page_size: int = 0, page_token: str = "") -> PhotoVerdictList:
        """What became of each photo of a scene's capture, in pages as `list_scenes`; the scene need not be ready.

        Raises:
            NotFoundError: there is no such scene.
            InvalidInputError: a negative size, or a token that no page returned.
        """
        size = check_page_size(page_size, self._settings.store)
        quality = self._store.scenes.scene(scene_id).quality
        return photo_page(self._store.photos.of_scene(scene_id), quality, size, page_token, scene_id)

    def list_scenes(self, page_size: int = 0, page_token: str = "") -> SceneList:
        """Scenes, newest first, in pages; dictionary, cameras and quality are left to `get_scene`.

        Args:
            page_size: at most this many; 0 for the server's default, larger values than its limit are cut to it.
            page_token: "" for the first page, then what the page before returned.

        Raises:
            InvalidInputError: a negative size, or a token that no page returned.
        """
        size = check_page_size(page_size, self._settings.store)
        records = self._store.scenes.list_scenes(size + 1, read_page_token(page_token))
        return SceneList(summaries_of(records[:size]), _next(records, size))

    def delete_scene(self, scene_id: str) -> None:
        """Forget a scene: its files go, its job stops, its request id is free again.

        Raises:
            NotFoundError: there is none of that id.
        """
        # On a full disk the row that frees space needs a little first.
        operation = self._store.reserve.lend(lambda: self._store.scenes.delete_scene(scene_id))
        for kept in (self._scenes, self.exports, self.localizing):
            kept.forget(scene_id)
        self._store.reserve.lend(lambda: self._store.keys.revoke_of_scene(scene_id, time.time()))
        self._store.blobs.drop_scene(scene_id)
        if operation is not None and operation.state != "RUNNING":  # else its worker cleans up behind its trainer
            self._store.blobs.drop_upload(operation.upload_id)
            self._store.blobs.drop_job(operation.run_id)
            remove(self._store.blobs.log(operation.id))


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


def _next(records: Sequence[SceneRecord] | Sequence[OperationRecord], size: int) -> str:
    """The token of the page after the first `size` records; "" if there are no more."""
    return write_page_token(records[size - 1].created_at, records[size - 1].id) if len(records) > size else ""
