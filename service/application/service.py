"""The service layer: all calls in one place, the only entry point of both transports."""

from __future__ import annotations

import copy
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

from sqlalchemy import Connection

from fastsplat.service.application.admin.admin import Admin
from fastsplat.service.application.admin.project_keys import ProjectKeys, check_unused
from fastsplat.service.application.admin.project_names import KnownNames
from fastsplat.service.application.admin.quotas import Quotas
from fastsplat.service.application.admin.server_capabilities import server_status
from fastsplat.service.application.answering.answers import Answers
from fastsplat.service.application.answering.contact_sheets import ContactSheets
from fastsplat.service.application.answering.localizing import Localizing
from fastsplat.service.application.answering.open_scenes import OpenScenes
from fastsplat.service.application.answering.photos import Photos, photo_page
from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.base.memory import MemoryBudget
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
from fastsplat.service.application.jobs.estimates import JobEstimates, QueueTimes
from fastsplat.service.application.jobs.naming_orders import OwnCaptioner, look_again_job
from fastsplat.service.application.jobs.running_jobs import RunningJobs
from fastsplat.service.application.jobs.stored import labels_of, left_out_to_json, scene_of, summary_of
from fastsplat.service.application.uploading.resumable import ResumableUploads
from fastsplat.service.application.uploading.sample_copies import copy_sample
from fastsplat.service.application.uploading.uploads import UploadSession
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.common.cache import LeastRecentlyUsed
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.common.process import machine_bytes
from fastsplat.service.jobs.needed_models import check_models
from fastsplat.service.settings import Settings
from fastsplat.service.store.blobs.blobs import remove
from fastsplat.service.store.blobs.reserve import check_free_space
from fastsplat.service.store.rows.codec import options_to_json
from fastsplat.service.store.rows.damaged_rows import each_readable
from fastsplat.service.store.rows.records import DEFAULT_PROJECT, NewJob, OperationRecord, SceneRecord
from fastsplat.service.store.store import Store, open_store
from fastsplat_contract.jobs.look_again import LookAgainIn
from fastsplat_contract.jobs.operations import Operation, OperationList, OperationState, SceneOptions
from fastsplat_contract.messages.scenes import LabelList, Scene, SceneList, SceneUpdate
from fastsplat_contract.photos.photo_verdicts import PhotoVerdictList
from fastsplat_contract.server.keys import Role
from fastsplat_contract.server.server_status import ServerStatus

MAX_LISTED = 5_000
"""Limit of a scene's labels and cameras in one response."""
_MAX_PROJECTS = 256
"""Projects, and scenes with keys of their own, whose parts are kept."""
_LEAST_MEMORY = 1 << 30
"""Bytes, below the peak of each whole job measured (`benchmarks/results/default_path.json`)."""

Admit = Callable[[Path, CaptureSettings, bool], ValidatedUpload]


class SceneService(AbstractContextManager["SceneService"]):
    """Scenes, operations and queries of one project (initially the default). Thread-safe.

    Synchronous. Other projects' data is invisible, see `in_project`. User-caused errors are `FastSplatError`s. Any
    number of instances and processes may share a data folder.
    """

    def __init__(self, store: Store, settings: Settings, admit: Admit | None = None) -> None:
        self._check_files = admit or admit_upload
        self._queue = QueueTimes(store, settings.jobs.stalled_worker_timeout_s)
        self.estimates = JobEstimates(settings)
        memory, mine = MemoryBudget(settings.calls, machine_bytes()), store.in_project(DEFAULT_PROJECT)
        scenes, quotas = OpenScenes(mine, settings, memory), Quotas(store.quota_usage, settings.quotas)
        context = ProjectContext(mine, settings, memory, scenes, KnownNames(mine, settings), quotas)
        self._prompted = PromptedEdits(context)
        files = settings.uploads
        self.resumable = ResumableUploads(
            store, settings.capture.max_upload_bytes, files.expiry_s, quotas, files.min_free_bytes
        )
        """Files uploaded in pieces, adopted by an upload once complete."""
        self.exports = Exports(context)
        self.localizing = Localizing(context)
        self.admin = Admin(store, settings, scenes.count)
        """Operator functions."""
        self._projects: LeastRecentlyUsed[tuple[str, str], SceneService] = LeastRecentlyUsed(_MAX_PROJECTS)
        self._bind(context)

    def _bind(self, context: ProjectContext) -> None:
        """Creates the parts that belong to one project; shared caches exist already."""
        self._context, self._store, self.project = context, context.store, context.project
        self.known_names = context.known_names
        self.answers = Answers(context)
        """Queries, pictures and files of finished scenes."""
        self.versions = Versions(context, self._prompted)
        self.photos = Photos(context)
        """Photos of finished scenes, and best views of objects."""
        self.sheets = ContactSheets(context)
        self.jobs = RunningJobs(context, self._queue)
        """Views into running jobs."""
        self.captioner = OwnCaptioner(context, self.jobs)
        self.observations = Observations(context, self.localizing, self.versions)
        self.keys = ProjectKeys(context.store, context.settings)

    def in_project(self, project: str, scene_id: str = "") -> SceneService:
        """This service for another project, or for one scene alone with `scene_id`.

        Made once. Threads, open scenes and limits are shared, so only one of them must be closed.
        """
        if (project, scene_id) == (self.project, self._store.only_scene):
            return self
        return self._projects.get((project, scene_id), lambda: 1, lambda: self._over(project, scene_id))

    def _over(self, project: str, scene_id: str) -> SceneService:
        clone, context = copy.copy(self), self._context.over(self._store.in_project(project, scene_id))
        clone.exports, clone.localizing = self.exports.over(context), self.localizing.over(context)
        clone._bind(context)
        return clone

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Releases scenes and connections."""
        self.localizing.close()
        self._context.scenes.close()
        self._store.close()

    @property
    def heartbeat_s(self) -> float:
        """Default heartbeat of a subscription after silence, in seconds."""
        return self._context.settings.calls.heartbeat_s

    def new_upload(self) -> UploadSession:
        """Session for a new scene's files; leaving it before `create_scene` removes them.

        Raises:
            QuotaError: the project is full.
            ResourceError: the disk is almost full.
        """
        settings = self._context.settings
        self._context.quotas.check_room(self.project, 0)
        check_space = partial(check_free_space, self._store.blobs.root, settings.uploads.min_free_bytes)
        check_space()
        upload_id = uuid.uuid4().hex
        return UploadSession(upload_id, self._store.blobs.upload(upload_id), settings.capture, check_space)

    def create_scene(
        self, upload: UploadSession, name: str, request_id: str, options: SceneOptions, upload_key: str = ""
    ) -> Operation:
        """Validates an upload, which ends in any case, and queues its job; durable.

        Args:
            name: for people; may be empty.
            request_id: the same id with the same content returns the same operation; "" for none.
            upload_key: id of the upload key that this uses up; "" for none.

        Raises:
            ConflictError: the request id was used for other content, or the key for another scene.
            InvalidInputError: labels that the configured detectors cannot know, without label maps.
            ModelUnavailableError: a model of the job is missing, or a detector for the redaction of people or movers.
            FastSplatError: the files are refused by `validate_upload`; nothing is kept.
        """
        with upload.committing():
            check_request(name, request_id, options, self._context.settings.store)
            digest = upload.digest(name, options)
            earlier = self._store.scenes.find_request(request_id, digest, self.project)
            if earlier is not None:
                remove(upload.folder)
                return self.jobs.operation(earlier)
            validated = self._check_files(upload.raw, self._context.settings.capture, options.strict)
            upload.check_names(validated.source, validated.has_labels)
            settings = self._context.settings_in_use
            check_labels(options, validated, settings)
            check_models(settings, given_labels=validated.has_labels, named=bool(options.labels))
            check_splat_options(validated, options)
            predicted = self.estimates.predicted(validated, options)
            upload.replace_files(validated.folder)
            self._store.blobs.keep_upload(upload.id)
            check_cancelled()  # no cancellation after this point
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
                gpus=int(settings.training.backend == "cuda"),
                memory=_LEAST_MEMORY,
            )

            def within(connection: Connection) -> None:
                self._context.quotas.reserve(connection, self.project, job.scene_id, upload.bytes)
                if upload_key:
                    check_unused(connection, upload_key, job.operation_id)

            record, new = self._store.scenes.create(job, within)
            if not new:
                self._store.blobs.drop_upload(upload.id)
            return self.jobs.operation(record)

    def open_sample(self) -> Scene:
        """The project's copy of the sample scene, created if missing; raises as `copy_sample`."""
        return self.get_scene(copy_sample(self._context))

    @property
    def max_entries(self) -> int:
        """Limit of files in an upload."""
        return self._context.settings.capture.max_entries

    def status(self, role: Role, key_id: str) -> ServerStatus:
        """Server capabilities and remaining quotas, as visible to the caller's role."""
        return server_status(self._store, self._context.settings_in_use, self.project, role, key_id)

    def look_again(self, scene_id: str, request: LookAgainIn) -> Operation:
        """Queues a job that searches a finished scene for more names; durable on return.

        Raises:
            NotFoundError, NotReadyError: no such scene, or it is not ready.
            FastSplatError: as `look_again_job` and `RunningJobs.order`.
        """
        self._context.scenes.finished(scene_id)
        job = look_again_job(scene_id, request, self.project, self._context.settings_in_use)
        return self.jobs.order(job)

    def get_operation(self, operation_id: str) -> Operation:
        """State of a job; raises `NotFoundError`."""
        return self.jobs.operation(self._store.scenes.operation(operation_id))

    def cancel_operation(self, operation_id: str) -> Operation:
        """Cancels a queued job at once, a running one at its worker's next check.

        A finished job is unchanged. Raises `NotFoundError`.
        """
        record = self._store.reserve.lend(lambda: self._store.scenes.cancel(operation_id))
        if record.state == "CANCELLED" and record.options.get("privacy"):
            self._store.blobs.drop_upload(record.upload_id)
        return self.jobs.operation(record)

    def retry_operation(self, operation_id: str, exclude: Sequence[str] = ()) -> Operation:
        """Queues a failed or cancelled job again, without excluded photos; raises as `RunningJobs.retry`."""
        return self.jobs.retry(operation_id, exclude)

    def list_operations(
        self, page_size: int = 0, page_token: str = "", state: OperationState | None = None
    ) -> OperationList:
        """Operations (in `state`, if given), newest first, paged as `list_scenes`."""
        size = check_page_size(page_size, self._context.settings.store)
        records = self._store.scenes.list_operations(size + 1, read_page_token(page_token), state)
        return OperationList(self.jobs.operations(records[:size]), _next(records, size))

    def get_scene(self, scene_id: str) -> Scene:
        """Scene with its first `MAX_LISTED` labels and cameras; raises `NotFoundError`."""
        return scene_of(self._store.scenes.scene(scene_id), MAX_LISTED)

    def update_scene(self, scene_id: str, update: SceneUpdate) -> Scene:
        """Renames a scene in any state.

        Raises:
            NotFoundError: no such scene.
            InvalidInputError, LimitExceededError: an unusable name.
            ConflictError: its name is not the expected one.
        """
        check_scene_name(update.name)
        self._store.scenes.rename(scene_id, update.name, update.expected_name)
        return self.get_scene(scene_id)

    def list_labels(self, scene_id: str, page_size: int = 0, page_token: str = "") -> LabelList:
        """A scene's dictionary by label id, paged as `list_scenes`."""
        size = check_page_size(page_size, self._context.settings.store)
        scene = self._store.scenes.scene(scene_id)
        page, token = page_of(scene.dictionary, size, page_token, f"labels {scene_id} {scene.state}")
        return LabelList(labels_of(scene, page), token)

    def list_photo_verdicts(self, scene_id: str, page_size: int = 0, page_token: str = "") -> PhotoVerdictList:
        """Registration result of each photo of a scene in any state, paged as `list_scenes`."""
        size = check_page_size(page_size, self._context.settings.store)
        quality = self._store.scenes.scene(scene_id).quality
        return photo_page(self._store.scenes.photos_of(scene_id), quality, size, page_token, scene_id)

    def list_scenes(self, page_size: int = 0, page_token: str = "") -> SceneList:
        """Scenes, newest first, in pages, without dictionary, cameras and quality.

        Args:
            page_size: 0: the server's default; capped at its limit.
            page_token: "" for the first page, then the previous page's token.

        Raises:
            InvalidInputError: a negative size, or an unknown token.
        """
        size = check_page_size(page_size, self._context.settings.store)
        records = self._store.scenes.list_scenes(size + 1, read_page_token(page_token))
        return SceneList(tuple(each_readable(records[:size], summary_of)), _next(records, size))

    def delete_scene(self, scene_id: str) -> None:
        """Deletes a scene, stops its job and frees its request id; raises `NotFoundError`."""
        # On a full disk, even deletion needs some space for its row.
        operation = self._store.reserve.lend(lambda: self._store.scenes.delete_scene(scene_id))
        for cache in (self._context.scenes, self.exports, self.localizing):
            cache.forget(scene_id)
        self._store.reserve.lend(lambda: self._store.keys.revoke_of_scene(scene_id, time.time()))
        self._store.blobs.drop_scene(scene_id)
        if operation is not None and operation.state != "RUNNING":  # else its worker cleans up
            self._store.blobs.drop_upload(operation.upload_id)
            self._store.blobs.drop_job(operation.run_id)
            remove(self._store.blobs.log(operation.id))


def open_service(settings: Settings, admit: Admit | None = None) -> SceneService:
    """Opens the service over `settings.data_dir`; `close` it when done.

    Args:
        admit: upload validation; by default `validate_in_sandbox`.

    Raises:
        InvalidInputError: the database URL is malformed.
        ResourceError: the data folder or the database is unusable.
    """
    return SceneService(open_store(settings.data_dir, settings.database_url, settings.artefacts), settings, admit)


def _next(records: Sequence[SceneRecord] | Sequence[OperationRecord], size: int) -> str:
    """Token of the page after the first `size` records; "" if there are no more."""
    return write_page_token(records[size - 1].created_at, records[size - 1].id) if len(records) > size else ""
