"""Supervisor of one job from claim to end: watches a trainer process, writes its progress, makes its end durable."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

from fastsplat.service.common.progress import ProgressEvent
from fastsplat.service.common.settings import environment_variable
from fastsplat.service.planning.presets import chosen_settings
from fastsplat.service.settings import JobSettings, Settings
from fastsplat.service.store.claims import Claim, FencedError, JobRequest
from fastsplat.service.store.store import Store
from fastsplat.workers.claimed_job import ClaimedJob
from fastsplat.workers.job_kinds import JobKind
from fastsplat.workers.job_outcome import CANCELLED, DONE, JobOutcome, failed
from fastsplat.workers.protocol import Done, Event, Failed, Job
from fastsplat.workers.results import DISK_FULL, disk_full_error, error_to_json
from fastsplat.workers.trainer_process import TrainerProcess
from fastsplat_contract.errors import (
    ConflictError,
    NotFoundError,
    NotReadyError,
    PermissionDeniedError,
    ResourceError,
    TrainerCrashedError,
    WorkerCrashedError,
)

logger = logging.getLogger(__name__)


_TRIES = 5
"""A scene that is edited again and again while its new names are written is left alone after so many."""
_DONE = "done"
"""Message of a stage's row once it is complete."""
_FURTHEST = "furthest"
"""In a stage's row: the largest fraction of it that any attempt has reported."""
_ADVANCE = 0.01
"""So much of a stage beyond the furthest attempt is progress; less may be the time between two reports."""


class StoppingError(Exception):
    """This worker is stopping; the job was given back unfinished."""


class Supervisor:
    """Runner of one claimed job. Once `stopping` is set, it gives the job back."""

    def __init__(
        self, store: Store, settings: Settings, claim: Claim, kind: JobKind, stopping: threading.Event
    ) -> None:
        self._settings = settings
        self._job = ClaimedJob(store, claim, settings.calls, settings.namer.host)
        self._kind = kind
        self._stopping = stopping
        self._trainer: TrainerProcess | None = None
        self._progress = _StageRows(claim.operation.stages, kind.stages)
        self._written_at = 0.0
        self._checked_at = 0.0

    def run(self) -> JobOutcome:
        """Have the stages done that are not, make the end durable, and clean up. Returns how the job ended.

        Raises:
            FencedError: another worker has claimed the job.
            StoppingError: this worker is stopping, and the job was given back.
        """
        error = self.start_limit_error()
        outcome = DONE if error is None else failed(error)
        if self._job.claim.attempt == 1 or not self._job.is_published():
            for stage in self._kind.stages:
                if outcome == DONE:
                    outcome = self.run_stage(stage)
        self.kill()
        if outcome == DONE:
            outcome = self._succeed()
        if outcome == CANCELLED:
            self._job.cancel()
        elif outcome.error is not None:
            self._job.fail(outcome.error)
        logger.info("job %s %s", self._job.id, outcome.state)
        self._job.clean_up(outcome)
        return outcome

    def start_limit_error(self) -> Mapping[str, Any] | None:
        """The error of a job that was started too often without progress, as JSON; None if it may run."""
        limit = self._settings.jobs.max_starts
        self._note_completed_stages(starts=min(self._job.starts, 2))  # this one, and the one that died after its stage
        if self._job.starts <= limit:
            return None
        error = WorkerCrashedError(
            f"the worker died {limit} times while it ran one stage of this job, so it is not run again",
            limit=_start_limit(limit),
            hint="Look into the worker's log for the reason, then retry the operation.",
        )
        stages = self._kind.stages
        last_stage = next((stage for stage in stages if not (self._job.folder / stage).is_dir()), stages[-1])
        return error_to_json(error, last_stage, log=self._log_name())

    def run_stage(self, stage: str) -> JobOutcome:
        """Have the trainer finish a stage.

        Raises:
            FencedError: another worker has claimed the job.
            StoppingError: this worker is stopping, and the job was given back.
        """
        while stage not in self._progress.done:
            try:
                trainer = self._trainer or self._start_trainer()
            except OSError as error:
                return failed(_cannot_start(error, stage))
            except PermissionDeniedError as error:
                return failed(error_to_json(error, stage))
            except (NotFoundError, NotReadyError) as error:  # the scene that it looks again at is gone
                return CANCELLED if self._job.is_cancelled() else failed(error_to_json(error, stage))
            try:
                event = trainer.next(self._settings.jobs.poll_interval_s)
            except EOFError:
                outcome = self._after_crash(stage, trainer)
                if outcome is not None:
                    return outcome
                continue
            if self._stopping.is_set():
                self.kill()
                self._job.release()
                raise StoppingError
            if isinstance(event, Failed):
                return failed(event.error)
            completed = event is not None and self._progress.update(event)
            files = event.files if isinstance(event, ProgressEvent) else {}
            for kind, entry in files.items():
                if kind == "draft":
                    self._job.publish_draft(entry)
                else:
                    self._job.publish_file(kind, entry)
            requests = self._requests(report=isinstance(event, Done) or bool(files), completed=completed)
            if "cancel" in requests:
                return CANCELLED
            if "finish" in requests:
                trainer.ask_to_finish()
        if stage == "capture":
            self._job.note_photos()
            self._job.drop_originals()
        return DONE

    def kill(self) -> None:
        """End the trainer and all processes that it started."""
        if self._trainer is not None:
            self._trainer.kill()
            self._trainer = None

    def _start_trainer(self) -> TrainerProcess:
        job, attempt = self._job, self._job.claim.attempt
        if not self._may_ask():
            raise PermissionDeniedError(
                "pictures of things do not go to a namer",
                field="namer",
                hint="An admin of the project agrees to the host of the server's namer, as by AgreeToNamer.",
            )
        job.folder.mkdir(parents=True, exist_ok=True)
        job.note_edits()
        folder, version = self._kind.sources(job)
        spec = Job(
            job.id,
            attempt,
            folder,
            job.folder,
            job.options,
            chosen_settings(self._settings, job.options),
            self._kind.stages,
            job.claim.operation.order,
            version,
            job.claim.operation.excluded,
        )
        self._trainer = TrainerProcess(spec, self._kind.run, job.log, asks_namer=self._kind.asks_namer)
        logger.info("job %s attempt %d pid %d", job.id, attempt, self._trainer.pid)
        return self._trainer

    def _after_crash(self, stage: str, trainer: TrainerProcess) -> JobOutcome | None:
        """Claim the job anew for another trainer and return None, or return how the job ends instead."""
        status = trainer.status()
        self.kill()
        self._note_completed_stages(starts=1)
        limit, starts = self._settings.jobs.max_starts, self._job.starts
        logger.warning("job %s: the trainer died in %s: %s", self._job.id, stage, status)
        if starts >= limit:
            error = TrainerCrashedError(
                f"the trainer died {starts} times in one stage, at last because {status}",
                limit=_start_limit(limit),
                hint="Use fewer or smaller images or a smaller budget of Gaussians, or a machine with more memory.",
            )
            return failed(error_to_json(error, stage, log=self._log_name()))
        if self._job.is_cancelled():
            return CANCELLED
        self._job.claim_again()
        self._progress.begin_attempt()
        return None

    def _note_completed_stages(self, starts: int) -> None:
        """Write, durably, that those stages are complete whose trainer or worker died before it could say so.

        If there are any, so many starts count from then on.
        """
        complete = [stage for stage in self._kind.stages if (self._job.folder / stage).is_dir()]
        unwritten = [stage for stage in complete if not self._progress.is_complete(stage)]
        if unwritten:
            for stage in unwritten:
                self._progress.complete(stage)
            self._job.note_completed(self._progress.rows, starts)

    def _requests(self, *, report: bool, completed: bool) -> frozenset[JobRequest]:
        """Look what was asked of the job, now and then; writes the progress if that is due, or if `report`.

        Once a stage is `completed`, or this attempt has come further than all before, earlier starts count no more.
        """
        completed = completed or (self._progress.advanced and self._job.starts > 1)
        jobs, now = self._settings.jobs, time.monotonic()
        if report or now - self._written_at >= jobs.progress_interval_s:
            self._written_at = self._checked_at = now
            self._job.note_edits()
            return self._job.report(self._progress.rows, starts=1 if completed else None) | self._taken_back()
        if now - self._checked_at < jobs.poll_interval_s:
            return frozenset()
        self._checked_at = now
        self._job.note_edits()
        return self._job.poll_requests() | self._taken_back()

    def _may_ask(self) -> bool:
        return not self._kind.asks_namer or self._job.may_ask_namer()

    def _taken_back(self) -> frozenset[JobRequest]:
        """A cancellation, where the project agrees no more that the job's namer is asked."""
        return frozenset() if self._may_ask() else frozenset(("cancel",))

    def _succeed(self) -> JobOutcome:
        """Publish what the job made; returns how the job ended after all.

        Where a finished scene was edited meanwhile, the job's result is put into what it was edited to.
        """
        last = self._kind.stages[-1]
        for remaining in reversed(range(_TRIES)):
            try:
                self._kind.publish(self._job, last)
                return DONE
            except (FencedError, NotFoundError):
                if not self._job.is_cancelled():
                    raise
                return CANCELLED
            except ConflictError as error:
                if not remaining:
                    return failed(error_to_json(error, last))
            except OSError as error:
                if error.errno not in DISK_FULL:
                    raise
                return failed(error_to_json(disk_full_error(), last))
            self._job.drop_result(last)
            self._progress.done.discard(last)
            outcome = self.run_stage(last)
            self.kill()
            if outcome != DONE:
                return outcome
        raise AssertionError

    def _log_name(self) -> str:
        return f"logs/{self._job.id}.log"


class _StageRows:
    """Progress of a job's stages as it is stored with the operation.

    Attributes:
        done: stages that the trainer has said to be complete.
        advanced: whether this attempt has come further in a stage than all before it.
    """

    def __init__(self, rows: Sequence[Mapping[str, Any]], stages: Sequence[str]) -> None:
        self._stages = stages
        self._rows = {row["stage"]: dict(row) for row in rows}
        self._started: dict[str, float] = {}
        self.done: set[str] = set()
        self.begin_attempt()

    @property
    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One row a stage that has begun, in order."""
        return [self._rows[stage] for stage in self._stages if stage in self._rows]

    def begin_attempt(self) -> None:
        """Forget how far this attempt has come, as another begins."""
        self.advanced = False
        self._furthest_before: dict[str, float] = {}

    def is_complete(self, stage: str) -> bool:
        """Whether the stage's end is in its row."""
        return bool(self._rows.get(stage, {}).get("message") == _DONE)

    def complete(self, stage: str) -> None:
        """Set the stage's row to its end."""
        self._row(stage).update(fraction=1.0, message=_DONE)

    def update(self, event: Event) -> bool:
        """Add what a trainer reported. Returns whether that completed a stage which was not complete before."""
        if isinstance(event, Failed):
            return False
        new = isinstance(event, Done) and not self.is_complete(event.stage)
        row = self._row(event.stage)
        if isinstance(event, Done):
            self.done.add(event.stage)
            self.complete(event.stage)
            if event.seconds:
                row["seconds"] = event.seconds
            return new
        now = time.monotonic()
        seconds = now - self._started.setdefault(event.stage, now)
        row.update(fraction=event.fraction, message=event.message, seconds=seconds)
        row["metrics"] = {**row["metrics"], **event.metrics}
        before = self._furthest_before.setdefault(event.stage, row.get(_FURTHEST, 0.0))
        self.advanced = self.advanced or event.fraction >= before + _ADVANCE
        row[_FURTHEST] = max(row.get(_FURTHEST, 0.0), event.fraction)
        return False

    def _row(self, stage: str) -> dict[str, Any]:
        new = {"stage": stage, "fraction": 0.0, "message": "", "seconds": 0.0, "metrics": {}}
        return self._rows.setdefault(stage, new)


def _start_limit(limit: int) -> str:
    return f"{limit} starts of one stage ({environment_variable(JobSettings, 'max_starts')})"


def _cannot_start(error: OSError, stage: str) -> Mapping[str, Any]:
    problem = ResourceError(
        f"the trainer cannot be started: {error.strerror}",
        field="data_dir",
        hint="Free disk space and memory on the server, then retry the operation.",
    )
    return error_to_json(problem, stage)
