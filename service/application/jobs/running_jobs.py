"""Running jobs, as those who wait for them see them: worker, previews, and an early end."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

from fastsplat.service.application.jobs.stored import operation_of
from fastsplat.service.settings import Settings
from fastsplat.service.store.damaged_rows import each_readable
from fastsplat.service.store.records import OperationRecord
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.job_watching import PlacedCameras, PlacedInfo, Preview, PreviewInfo, WorkerState
from fastsplat_contract.json_codec import from_json
from fastsplat_contract.operating_messages import JobLog
from fastsplat_contract.operations import FINAL_STATES, Operation

_MAX_LOG = 1 << 20


class RunningJobs:
    """The jobs of one project, while they run. Raises `DatabaseError` when the database is away."""

    def __init__(self, store: Store, settings: Settings) -> None:
        self._store, self._settings = store, settings

    def operation(self, record: OperationRecord) -> Operation:
        """What a caller sees of a job."""
        return operation_of(record, self._worker_of(record))

    def operations(self, records: Sequence[OperationRecord]) -> tuple[Operation, ...]:
        """The same of many, without those whose rows cannot be read."""
        return tuple(each_readable(records, self.operation))

    def finish(self, operation_id: str) -> Operation:
        """Ask a job to end its training early, once it has 250 steps, and to make its scene of what is there; asked
        again it changes nothing. A cancellation goes first. Returns the operation as it now stands.

        Raises:
            NotFoundError: there is none of that id.
            NotReadyError: it does not train: its first step is not done, its last one is, or it trains nothing.
        """
        return self.operation(self._store.reserve.lend(lambda: self._store.scenes.finish(operation_id)))

    def preview(self, operation_id: str) -> Preview:
        """The newest picture of a scene that is being trained.

        Raises:
            NotFoundError: there is no such operation, or no picture of it (any more).
            ObjectStoreError: the store that has it does not answer.
        """
        info, content = self._file(operation_id, "preview")
        return Preview(PreviewInfo(**info), content)

    def placed_cameras(self, operation_id: str) -> PlacedCameras:
        """The cameras that a job has placed so far, and some of its points.

        Raises:
            NotFoundError: there is no such operation, or no camera of it (any more).
            ObjectStoreError: the store that has them does not answer.
        """
        info, content = self._file(operation_id, "placed")
        stored = from_json(PlacedCameras, content)
        return PlacedCameras(PlacedInfo(**info), stored.cameras, stored.points, stored.colors)

    def log(self, operation_id: str) -> JobLog:
        """The end of what the trainers of a job wrote.

        Raises:
            NotFoundError: there is no such operation, or no log of it on this machine.
        """
        path = self._store.blobs.log(self._store.scenes.operation(operation_id).id)
        try:
            with path.open("rb") as file:
                file.seek(max(0, path.stat().st_size - _MAX_LOG))
                return JobLog(file.read().decode(errors="replace"))
        except FileNotFoundError:
            raise NotFoundError(
                f"job {operation_id} has no log on this machine",
                field="operation",
                hint="Logs are kept on the machine of the worker, of jobs that run or failed, for a while.",
            ) from None

    def _file(self, operation_id: str, kind: str) -> tuple[Mapping[str, Any], bytes]:
        before = None
        while True:
            record = self._store.scenes.operation(operation_id)
            entry = (record.progress_files or {}).get(kind)
            if entry is None or entry == before or record.state in FINAL_STATES:
                raise NotFoundError(
                    f"operation {operation_id!r} shows nothing of that kind now",
                    field="operation",
                    hint="Look at preview and placed of the operation; a job that is done shows its scene instead.",
                )
            content = self._store.blobs.read_progress_file(record.run_id, entry["file"])
            if content is not None:
                return entry["info"], content
            before = entry  # replaced since the row was read: then there is a newer one

    def _worker_of(self, record: OperationRecord) -> WorkerState | None:
        if record.state in FINAL_STATES:
            return None
        timeout_s = self._settings.jobs.stalled_worker_timeout_s
        if record.state == "RUNNING" and time.time() - record.updated_at <= timeout_s:
            return "working"
        if not self._store.workers.any_alive(timeout_s):
            return "none"
        return "silent" if record.state == "RUNNING" else "waiting"
