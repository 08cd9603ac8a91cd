"""One job from claim to end: a trainer process is watched, its progress written, its end made durable."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from sqlalchemy.exc import DBAPIError

from fastsplat.service.application.stored import options_of
from fastsplat.service.common.progress import STAGES, ProgressEvent
from fastsplat.service.settings import Settings
from fastsplat.service.store import Store
from fastsplat.service.store.blobs import remove
from fastsplat.service.store.jobs import Claim, FencedError
from fastsplat.service.store.records import SceneSummary
from fastsplat.workers.process import TrainerProcess
from fastsplat.workers.protocol import Done, Event, Failed, Job
from fastsplat.workers.results import FULL, disk_full, error_to_json
from fastsplat_contract.errors import (
    DatabaseError,
    ObjectStoreError,
    ResourceError,
    TrainerCrashedError,
    WorkerCrashedError,
)

logger = logging.getLogger(__name__)
T = TypeVar("T")

DONE: Mapping[str, Any] = {"outcome": "done"}
CANCELLED: Mapping[str, Any] = {"outcome": "cancelled"}
_PATIENCE_S = 600.0


class StoppingError(Exception):
    """This worker is leaving; the job is given back unfinished."""


class Supervisor:
    """Runs one claimed job. `stopping` makes it give the job back."""

    def __init__(self, store: Store, settings: Settings, claim: Claim, stages: str, stopping: threading.Event) -> None:
        self._store = store
        self._settings = settings
        self._claim = claim
        self._stages = stages
        self._stopping = stopping
        self._trainer: TrainerProcess | None = None
        self._rows = {row["stage"]: dict(row) for row in claim.operation.stages}
        self._done: set[str] = set()
        self._failed: Mapping[str, Any] | None = None
        self._written_at = 0.0
        self._checked_at = 0.0
        self._stage_started: dict[str, float] = {}
        self._ending = False
        self._suspect: Claim | None = None

    def parked(self) -> Mapping[str, Any] | None:
        """The error of a job that was started too often, or None if it may run."""
        limit = self._settings.jobs.max_starts
        if self._claim.operation.starts <= limit:
            return None
        error = WorkerCrashedError(
            f"the worker died {limit} times while it ran this job, so the job was parked",
            limit=f"{limit} starts (FASTSPLAT_JOBS__MAX_STARTS)",
            hint="Look into the worker's log for the reason, then post the capture again.",
        )
        return error_to_json(error, self._last_stage(), log=self._log_name())

    def run_stage(self, stage: str) -> Mapping[str, Any]:
        """Have the trainer finish a stage.

        Returns:
            JSON with "outcome": "done", "cancelled", or "failed" with an "error".

        Raises:
            FencedError: somebody else has the job now.
            StoppingError: this worker is leaving, and the job was given back.
        """
        while stage not in self._done:
            if self._trainer is None:
                try:
                    self._trainer = TrainerProcess(self._job(), self._stages, self._log())
                except OSError as error:
                    return {"outcome": "failed", "error": self._no_start(error, stage)}
                logger.info(
                    "job %s attempt %d pid %d", self._claim.operation.id, self._claim.attempt, self._trainer.pid
                )
            try:
                event = self._trainer.next(self._settings.jobs.poll_s)
            except EOFError:
                crash = self._after_crash(stage, self._trainer)
                if crash is not None:
                    return crash
                continue
            if self._stopping.is_set():
                self.kill()
                self._patiently(lambda: self._store.jobs.release(self._claim))
                raise StoppingError
            if event is not None:
                self._take(event)
            if self._failed is not None:
                return {"outcome": "failed", "error": dict(self._failed)}
            if self._write(force=isinstance(event, Done)):
                return CANCELLED
        return DONE

    def finish(self, outcome: Mapping[str, Any]) -> None:
        """Make the end durable, then clean up.

        Raises:
            FencedError: somebody else has the job now.
        """
        self._ending = True
        jobs, blobs, operation = self._store.jobs, self._store.blobs, self._claim.operation
        if outcome["outcome"] == "done" and not self._exported():
            # The stages were recorded, but on a machine whose folder this one does not see.
            outcome = self.run_stage("export")
        self.kill()
        if outcome["outcome"] == "done":
            outcome = self._succeed()
        if outcome["outcome"] == "cancelled":
            self._patiently(lambda: jobs.cancelled(self._claim))
        elif outcome["outcome"] == "failed":
            self._patiently(lambda: jobs.fail(self._claim, outcome["error"]))
        logger.info("job %s %s", operation.id, outcome["outcome"])
        remove(blobs.job(operation.id))
        if outcome["outcome"] != "failed":
            remove(blobs.log(operation.id))
        with suppress(ObjectStoreError):  # the janitor will do it
            blobs.drop_upload(operation.upload_id)
            if outcome["outcome"] != "done":
                blobs.drop_scene(operation.scene_id)

    def lost(self) -> bool:
        """Whether the job is in other hands for sure: seen twice in a row. For a thread beside the one that runs it.

        The job engine knows of lost jobs too, and then waits for their new owner, where this could not end the trainer.
        """
        claim, before = self._claim, self._suspect
        try:
            self._store.jobs.check(claim)
            self._suspect = None
        except FencedError:
            self._suspect = claim
        # A new attempt of our own, or the end, changes the rows before it changes this object.
        return self._suspect is not None and before is claim is self._claim and not self._ending

    def kill(self) -> None:
        """End the trainer and all it started."""
        if self._trainer is not None:
            self._trainer.kill()
            self._trainer = None

    def _after_crash(self, stage: str, trainer: TrainerProcess) -> Mapping[str, Any] | None:
        how = trainer.status()
        self.kill()
        limit = self._settings.jobs.max_starts
        starts = self._claim.operation.starts
        logger.warning("job %s: the trainer died in %s: %s", self._claim.operation.id, stage, how)
        if starts >= limit:
            error = TrainerCrashedError(
                f"the trainer died {starts} times, at last because {how}",
                limit=f"{limit} starts (FASTSPLAT_JOBS__MAX_STARTS)",
                hint="Use fewer or smaller images or a smaller budget of Gaussians, or a machine with more memory.",
            )
            return {"outcome": "failed", "error": error_to_json(error, stage, log=self._log_name())}
        if self._patiently(lambda: self._store.jobs.check(self._claim)):
            return CANCELLED
        claim = self._patiently(lambda: self._store.jobs.claim(self._claim.operation.id))
        if claim is None:
            raise FencedError(self._claim.operation.id)
        self._claim = claim
        return None

    def _no_start(self, error: OSError, stage: str) -> Mapping[str, Any]:
        problem = ResourceError(
            f"the trainer cannot be started: {error.strerror}",
            field="data_dir",
            hint="Free disk space and memory on the server, then post the capture again.",
        )
        return error_to_json(problem, stage)

    def _take(self, event: Event) -> None:
        now = time.monotonic()
        if isinstance(event, Failed):
            self._failed = event.error
            return
        row = self._rows.setdefault(
            event.stage, {"stage": event.stage, "fraction": 0.0, "message": "", "seconds": 0.0, "metrics": {}}
        )
        if isinstance(event, Done):
            self._done.add(event.stage)
            row.update(fraction=1.0, message="done")
            if event.seconds:
                row["seconds"] = event.seconds
        elif isinstance(event, ProgressEvent):
            started = self._stage_started.setdefault(event.stage, now)
            row.update(fraction=event.fraction, message=event.message, seconds=now - started)
            row["metrics"] = {**row["metrics"], **event.metrics}

    def _write(self, *, force: bool) -> bool:
        """Write progress if it is time, and look whether the job is wanted. Returns whether it was cancelled."""
        now = time.monotonic()
        if not force and now - self._written_at < self._settings.jobs.progress_s:
            if now - self._checked_at < self._settings.jobs.poll_s:
                return False
            self._checked_at = now
            return self._soon(lambda: self._store.jobs.check(self._claim))
        self._written_at = self._checked_at = now
        rows = [self._rows[stage] for stage in STAGES if stage in self._rows]
        return self._soon(lambda: self._store.jobs.report(self._claim, rows))

    def _soon(self, look: Callable[[], bool]) -> bool:
        # A database that restarts in mid-job costs some progress reports, not the job.
        try:
            return look()
        except DBAPIError as error:
            logger.warning("the database does not answer (%s); will ask again", type(error.orig).__name__)
            return False

    def _patiently(self, act: Callable[[], T]) -> T:
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            try:
                return act()
            except (DBAPIError, DatabaseError, ObjectStoreError):
                if time.monotonic() > deadline:
                    raise
                time.sleep(1.0)

    def _succeed(self) -> Mapping[str, Any]:
        """Publish the scene and show it; returns how the job ended after all."""
        try:
            summary = self._patiently(self._publish)
            self._patiently(lambda: self._store.jobs.succeed(self._claim, summary))
        except FencedError:
            if not self._patiently(lambda: self._store.jobs.check(self._claim)):
                raise
            return CANCELLED
        except OSError as error:
            if error.errno not in FULL:
                raise
            return {"outcome": "failed", "error": error_to_json(disk_full(), "export")}
        return DONE

    def _exported(self) -> bool:
        operation, blobs = self._claim.operation, self._store.blobs
        return (blobs.job(operation.id) / "export").is_dir() or bool(
            self._patiently(lambda: blobs.fetch_version(operation.scene_id, operation.id))
        )

    def _publish(self) -> SceneSummary:
        operation, blobs = self._claim.operation, self._store.blobs
        version = operation.id
        target = blobs.fetch_version(operation.scene_id, version)
        if target is None:  # else an earlier attempt got exactly this far
            target = blobs.publish(blobs.job(operation.id) / "export", operation.scene_id, version)
        summary = json.loads((target / "summary.json").read_text())
        seconds = json.loads((target / "stage.json").read_text())["seconds"]
        summary["quality"]["stage_seconds"]["export"] = seconds
        return SceneSummary(version=version, **summary)

    def _job(self) -> Job:
        operation, blobs = self._claim.operation, self._store.blobs
        folder = blobs.job(operation.id)
        folder.mkdir(parents=True, exist_ok=True)
        options = options_of(operation)
        upload = self._patiently(lambda: blobs.fetch_upload(operation.upload_id)) / operation.options["admitted"]
        return Job(operation.id, self._claim.attempt, upload, folder, options, self._settings)

    def _last_stage(self) -> str:
        """The stage in which the last attempt ended: the first whose result is not there."""
        folder = self._store.blobs.job(self._claim.operation.id)
        return next((stage for stage in STAGES if not (folder / stage).is_dir()), STAGES[-1])

    def _log(self) -> Path:
        return self._store.blobs.log(self._claim.operation.id)

    def _log_name(self) -> str:
        return f"logs/{self._claim.operation.id}.log"
