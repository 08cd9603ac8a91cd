"""Jobs for waiting callers: orders, worker state, previews, log, early finish, and retries."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.jobs.estimates import QueueTimes
from fastsplat.service.application.jobs.stored import operation_of
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.uploads.photo_exclusion import photo_paths, without_photos
from fastsplat.service.store.repositories.scene_repository import no_upload
from fastsplat.service.store.rows.damaged_rows import each_readable
from fastsplat.service.store.rows.records import NewJob, OperationRecord
from fastsplat.service.store.store import Store
from fastsplat_contract.codec.json_codec import from_json
from fastsplat_contract.errors import InvalidInputError, NotFoundError, NotReadyError
from fastsplat_contract.jobs.job_watching import PlacedCameras, PlacedInfo, Preview, PreviewInfo, WorkerState
from fastsplat_contract.jobs.operations import FINAL_STATES, Operation
from fastsplat_contract.messages.projects import JobLog

_MAX_LOG = 1 << 20


class RunningJobs:
    """Jobs of one project. Raises `DatabaseError` if the database is unavailable."""

    def __init__(self, context: ProjectContext, queue: QueueTimes) -> None:
        self._context, self._queue = context, queue

    def order(self, job: NewJob) -> Operation:
        """Queues a job, or returns the operation of the same earlier request. Durable on return.

        Raises:
            ConflictError: the request id was used for another request.
            QuotaError: too many active jobs in the project.
        """
        scenes = self._context.store.scenes
        record = scenes.find_request(job.request_id, job.request_digest, job.project)
        if record is None:
            self._context.quotas.check_retry(job.project)
            record = scenes.add_job(job)
        return self.operation(record)

    def operation(self, record: OperationRecord) -> Operation:
        """Converts an operation row for callers; raises `ArtefactError` if it is damaged."""
        return self._converting((record,))(record)

    def operations(self, records: Sequence[OperationRecord]) -> tuple[Operation, ...]:
        """Converts many operation rows, skipping unreadable ones."""
        return tuple(each_readable(records, self._converting(records)))

    def finish(self, operation_id: str) -> Operation:
        """Ends a job's training early, after at least 250 steps, and keeps its scene.

        Idempotent; a cancellation takes precedence. Raises `NotReadyError` before the first step, after the last, and
        without training.
        """
        return self.operation(self._context.store.reserve.lend(lambda: self._context.store.scenes.finish(operation_id)))

    def retry(self, operation_id: str, exclude: Sequence[str]) -> Operation:
        """Queues a failed or cancelled job again; other jobs stay unchanged.

        `exclude` are photos to leave out, in addition to those of earlier retries.

        Raises:
            NotFoundError: no such job, or its scene or upload was deleted.
            InvalidInputError: an unknown photo, or too few remain.
            NotReadyError: new exclusions for a job that neither failed nor was cancelled.
            QuotaError: too many active jobs in the project.
        """
        context = self._context
        store = context.store
        record = store.scenes.operation(operation_id)
        if record.state in ("FAILED", "CANCELLED"):
            if record.makes_scene and record.upload_id not in store.blobs.ids("uploads"):
                raise no_upload(operation_id)
            context.quotas.check_retry(context.project)
        paths = _checked(record, exclude, store) if exclude else ()
        if not set(paths) <= set(record.excluded) and record.state not in ("FAILED", "CANCELLED"):
            raise NotReadyError(
                f"operation {operation_id!r} is {record.state}",
                field="exclude",
                hint="Its scene is made with all its photos; delete it, and post the others as a new one."
                if record.state in FINAL_STATES
                else "Cancel it first, then retry it without them.",
            )
        ended_since = time.time() - context.settings.uploads.failed_retention_s
        return self.operation(store.jobs.retry(operation_id, ended_since, paths))

    def preview(self, operation_id: str) -> Preview:
        """Latest preview of a scene in training; raises `NotFoundError` without one, or `ObjectStoreError`."""
        info, content = self._file(operation_id, "preview")
        return Preview(PreviewInfo(**info), content)

    def placed_cameras(self, operation_id: str) -> PlacedCameras:
        """Cameras registered so far, with some points; raises `NotFoundError` without any, or `ObjectStoreError`."""
        info, content = self._file(operation_id, "placed")
        stored = from_json(PlacedCameras, content)
        return PlacedCameras(PlacedInfo(**info), stored.cameras, stored.points, stored.colors)

    def log(self, operation_id: str) -> JobLog:
        """Last MiB of a job's training log; raises `NotFoundError` without one, or `ObjectStoreError`."""
        store = self._context.store
        content = store.blobs.read_log(store.scenes.operation(operation_id).id, _MAX_LOG)
        if content is None:
            raise NotFoundError(
                f"job {operation_id} has no log",
                field="operation",
                hint="Logs are kept of jobs that run or failed, for a while.",
            )
        return JobLog(content.decode(errors="replace"))

    def _file(self, operation_id: str, kind: str) -> tuple[Mapping[str, Any], bytes]:
        before = None
        while True:
            record = self._context.store.scenes.operation(operation_id)
            entry = (record.progress_files or {}).get(kind)
            if entry is None or entry == before or record.state in FINAL_STATES:
                raise NotFoundError(
                    f"operation {operation_id!r} shows nothing of that kind now",
                    field="operation",
                    hint="Look at preview and placed of the operation; a job that is done shows its scene instead.",
                )
            content = self._context.store.blobs.read_progress_file(record.run_id, entry["file"])
            if content is not None:
                return entry["info"], content
            before = entry  # replaced since the row was read: read again

    def _converting(self, records: Sequence[OperationRecord]) -> Callable[[OperationRecord], Operation]:
        ahead, runs = self._queue.ahead(records), self._context.store.jobs.attempts_of([job.id for job in records])
        return lambda job: replace(operation_of(job, self._worker_of(job), ahead.get(job.id)), attempts=runs[job.id])

    def _worker_of(self, record: OperationRecord) -> WorkerState | None:
        if record.state in FINAL_STATES:
            return None
        timeout_s, now = self._context.settings.jobs.stalled_worker_timeout_s, time.time()
        claimed = record.state == "RUNNING" and record.run_after <= now
        if claimed and now - record.updated_at <= timeout_s:
            return "working"
        if not self._context.store.workers.alive(timeout_s):
            return "none"
        return "silent" if claimed else "waiting"


def _checked(record: OperationRecord, exclude: Sequence[str], store: Store) -> tuple[str, ...]:
    """Paths of the photos to exclude from a job's upload."""
    if not record.makes_scene:
        raise InvalidInputError(
            f"a job of the kind {record.kind} reads no upload that photos could be left out of",
            field="exclude",
            hint="Retry it without.",
        )
    if record.upload_id not in store.blobs.ids("uploads"):
        raise no_upload(record.id)
    manifest, _ = read_manifest(store.blobs.fetch_upload(record.upload_id) / record.options["validated"])
    paths = photo_paths(manifest, exclude)
    without_photos(manifest, {*record.excluded, *paths})
    return paths
