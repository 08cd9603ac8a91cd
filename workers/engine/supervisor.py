"""Supervises a job: runs its trainer process, records progress and outcome."""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from fastsplat.service.common.process import PARENT_VARIABLE
from fastsplat.service.common.progress import ProgressEvent
from fastsplat.service.common.setting_groups import environment_variable
from fastsplat.service.planning.presets import chosen_settings
from fastsplat.service.settings import JobSettings, Settings
from fastsplat.service.store.queue.claims import Claim, FencedError, JobRequest
from fastsplat.service.store.store import Store
from fastsplat.workers.job.claimed_job import CANCELLED, DONE, ClaimedJob, JobOutcome, failed
from fastsplat.workers.job.protocol import Done, Event, Failed, Job, read_event
from fastsplat.workers.job.results import DISK_FULL, disk_full_error, error_to_json, log_name
from fastsplat.workers.kinds.job_kinds import JobKind
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
"""Publication attempts while the scene is edited concurrently."""
_DONE = "done"  # message of a complete stage's row
_FURTHEST = "furthest"  # row key of the largest fraction reported by any attempt
_STORED = "stored"  # row key of the attempt whose result of the stage is stored for workers elsewhere
_ADVANCE = 0.01
"""Progress beyond the furthest attempt that counts; less may be report timing."""

# The kernel's death signal is bound to the forking thread, so one that never ends forks all trainers.
_forker = ThreadPoolExecutor(1, thread_name_prefix="forker")
_GRACE_S = 2.0
_FIRST_PAUSE = 5.0  # of a job after its first crash, in poll intervals; doubled by each further one


class ReturnedError(Exception):
    """The job was returned unfinished: the worker is stopping, or the trainer died."""


class Supervisor:
    """Runs a claimed job; returns it once `stopping` is set, or its trainer dies."""

    def __init__(
        self, store: Store, settings: Settings, claim: Claim, kind: JobKind, stopping: threading.Event
    ) -> None:
        self._settings = settings
        self._job = ClaimedJob(store, claim, settings.calls, settings.captioner.host)
        self._kind = kind
        self._stopping = stopping
        self._trainer: TrainerProcess | None = None
        self._progress = _StageRows(claim.operation.stages, kind.stages)
        self._written_at = 0.0
        self._checked_at = 0.0

    def run(self) -> JobOutcome:
        """Runs missing stages, records the outcome durably and cleans up.

        Raises:
            FencedError: another worker has claimed the job.
            ReturnedError: the job was returned.
        """
        self._job.fetch_results(self._progress.stored)
        self._job.drop_originals()  # or they would be looked for
        error = self.start_limit_error()
        outcome = DONE if error is None else failed(error)
        if self._job.claim.attempt == 1 or not self._job.is_published():
            for stage in self._kind.stages:
                if outcome == DONE:
                    outcome = self.run_stage(stage)
        self.kill()
        if outcome == DONE:
            outcome = self._succeed()
        if outcome.error is not None:
            self._job.keep_log()
        if outcome != DONE:
            self._job.end(outcome.error)
        logger.info("job %s %s", self._job.id, outcome.state)
        self._job.clean_up(outcome)
        return outcome

    def start_limit_error(self) -> Mapping[str, Any] | None:
        """Returns the error of a job started too often without progress, or None."""
        limit = self._settings.jobs.max_starts
        # This start, and the one that died after its stage.
        self._note_completed_stages(starts=min(self._job.starts, 2))
        if self._job.starts <= limit:
            return None
        error = WorkerCrashedError(
            f"the worker died {limit} times while it ran one stage of this job, so it is not run again",
            limit=_start_limit(limit),
            hint="Look into the worker's log for the reason, then retry the operation.",
        )
        stages = self._kind.stages
        last_stage = next((stage for stage in stages if not (self._job.folder / stage).is_dir()), stages[-1])
        return error_to_json(error, last_stage, log=log_name(self._job.id))

    def run_stage(self, stage: str) -> JobOutcome:
        """Has the trainer finish a stage; raises as `run`."""
        while stage not in self._progress.done:
            try:
                trainer = self._trainer or self._start_trainer()
            except OSError as error:
                problem = f"the trainer cannot be started: {error.strerror}"
                hint = "Free disk space and memory on the server, then retry the operation."
                return failed(error_to_json(ResourceError(problem, field="data_dir", hint=hint), stage))
            except PermissionDeniedError as error:
                return failed(error_to_json(error, stage))
            except (NotFoundError, NotReadyError) as error:  # the finished scene is gone
                return CANCELLED if self._job.is_cancelled() else failed(error_to_json(error, stage))
            try:
                event = trainer.next(self._settings.jobs.poll_interval_s)
            except EOFError:
                return self._after_crash(stage, trainer)
            if self._stopping.is_set():
                self.kill()
                self._job.release()
                raise ReturnedError
            if isinstance(event, Failed):
                return failed(event.error)
            completed = event is not None and self._progress.update(event)
            files = event.files if isinstance(event, ProgressEvent) else {}
            for kind, entry in files.items():
                if kind == "draft":
                    self._job.publish_draft(entry)
                else:
                    self._job.publish_file(kind, entry)
            if isinstance(event, Done) and event.stage not in (*self._progress.stored, self._kind.stages[-1]):
                self._progress.note_stored(event.stage, self._job.keep_result(event.stage))
            if isinstance(event, Done) or files:
                self._job.keep_log()
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
        if self._trainer is not None:
            self._trainer.kill()
            self._trainer = None

    def _start_trainer(self) -> TrainerProcess:
        job, attempt = self._job, self._job.claim.attempt
        if not self._may_ask():
            raise PermissionDeniedError(
                "pictures of objects do not go to a captioner",
                field="captioner",
                hint="An admin of the project agrees to the host of the server's captioner, as by AgreeToCaptioner.",
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
            tuple(job.claim.operation.excluded),
        )
        self._trainer = TrainerProcess(spec, self._kind.run, job.log, asks_captioner=self._kind.asks_captioner)
        saved_s = sum(row["seconds"] for row in self._progress.rows if (job.folder / row["stage"]).is_dir())
        logger.info("job %s attempt %d pid %d, %.1f s of work saved", job.id, attempt, self._trainer.pid, saved_s)
        return self._trainer

    def _after_crash(self, stage: str, trainer: TrainerProcess) -> JobOutcome:
        """Returns the final outcome, or raises `ReturnedError` after returning the job for a later claim."""
        status = trainer.status()
        self.kill()
        self._job.keep_log()
        self._note_completed_stages(starts=1)
        limit, starts = self._settings.jobs.max_starts, self._job.starts
        logger.warning("job %s: the trainer died in %s: %s", self._job.id, stage, status)
        if starts >= limit:
            error = TrainerCrashedError(
                f"the trainer died {starts} times in one stage, at last because {status}",
                limit=_start_limit(limit),
                hint="Use fewer or smaller images or a smaller budget of Gaussians, or a machine with more memory.",
            )
            return failed(error_to_json(error, stage, log=log_name(self._job.id)))
        if self._job.is_cancelled():
            return CANCELLED
        pause = _FIRST_PAUSE * 2 ** min(starts - 1, 10)
        self._job.note_completed(self._progress.rows, starts)
        self._job.release(pause * self._settings.jobs.poll_interval_s)
        raise ReturnedError

    def _note_completed_stages(self, starts: int) -> None:
        """Records stages whose trainer or worker died before reporting them, and `starts`."""
        complete = [stage for stage in self._kind.stages if (self._job.folder / stage).is_dir()]
        unwritten = [stage for stage in complete if not self._progress.is_complete(stage)]
        if unwritten:
            for stage in unwritten:
                self._progress.complete(stage)
            self._job.note_completed(self._progress.rows, starts)

    def _requests(self, *, report: bool, completed: bool) -> frozenset[JobRequest]:
        """Polls requests; writes progress if due. A `completed` stage or progress resets the start count."""
        completed = completed or (self._progress.advanced and self._job.starts > 1)
        jobs, now = self._settings.jobs, time.monotonic()
        report = report or now - self._written_at >= jobs.progress_interval_s
        if not report and now - self._checked_at < jobs.poll_interval_s:
            return frozenset()
        self._checked_at, self._written_at = now, now if report else self._written_at
        self._job.note_edits()
        requests = self._job.requests(self._progress.rows if report else None, 1 if completed else None)
        return requests if self._may_ask() else frozenset(("cancel",))  # the project withdrew its consent

    def _may_ask(self) -> bool:
        return not self._kind.asks_captioner or self._job.may_ask_captioner()

    def _succeed(self) -> JobOutcome:
        """Publishes the result; redoes the last stage if the scene was edited meanwhile."""
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


class _StageRows:
    """Progress rows of a job's stages, as stored with the operation."""

    def __init__(self, rows: Sequence[Mapping[str, Any]], stages: Sequence[str]) -> None:
        self._stages = stages
        self._rows = {row["stage"]: dict(row) for row in rows}
        self._started: dict[str, float] = {}
        self.done: set[str] = set()  # reported complete by the trainer
        self.advanced = False  # further in a stage than all earlier attempts
        self._furthest_before: dict[str, float] = {}

    @property
    def rows(self) -> Sequence[Mapping[str, Any]]:
        return [self._rows[stage] for stage in self._stages if stage in self._rows]

    @property
    def stored(self) -> Mapping[str, int]:
        """Attempts whose results of stages, in order, are stored."""
        return {row["stage"]: row[_STORED] for row in self.rows if row.get(_STORED)}

    def note_stored(self, stage: str, attempt: int) -> None:
        self._row(stage)[_STORED] = attempt

    def is_complete(self, stage: str) -> bool:
        return bool(self._rows.get(stage, {}).get("message") == _DONE)

    def complete(self, stage: str) -> None:
        self._row(stage).update(fraction=1.0, message=_DONE)

    def update(self, event: ProgressEvent | Done) -> bool:
        """Applies a trainer's event; returns True if it newly completes a stage."""
        row = self._row(event.stage)
        if isinstance(event, Done):
            new = not self.is_complete(event.stage)
            self.done.add(event.stage)
            self.complete(event.stage)
            if event.seconds:
                row["seconds"] = event.seconds
            return new
        for stage in self._stages[self._stages.index(event.stage) :]:  # what is made again, and all that follows it
            self._rows.get(stage, {}).pop(_STORED, None)
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


class TrainerProcess:
    """A running trainer with its process group and events."""

    def __init__(self, job: Job, run: str, log: Path, *, asks_captioner: bool = False) -> None:
        log.parent.mkdir(parents=True, exist_ok=True)
        self._process = _forker.submit(_start, job, log).result()
        self._events: queue.SimpleQueue[Event | None] = queue.SimpleQueue()
        self._ended_at: float | None = None
        self._finish_mark = job.finish_mark
        threading.Thread(target=self._read, name=f"events of {job.operation_id}", daemon=True).start()
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # died already; see its exit status
            self._process.stdin.write(job.to_line(run, asks_captioner=asks_captioner))
            self._process.stdin.flush()

    @property
    def pid(self) -> int:
        """Id of the process and of its group."""
        return self._process.pid

    def next(self, timeout: float) -> Event | None:
        """Returns the next event, or None after `timeout` seconds; EOFError after the last."""
        try:
            event = self._events.get(timeout=timeout)
        except queue.Empty:
            # A stray grandchild may hold the pipe open after the trainer's death; do not wait for it.
            if self._process.poll() is not None:
                self._ended_at = self._ended_at or time.monotonic()
                if time.monotonic() - self._ended_at > _GRACE_S:
                    raise EOFError from None
            return None
        if event is None:
            self._events.put(None)
            raise EOFError
        return event

    def ask_to_finish(self) -> None:
        """Requests an early end of training, also of later attempts; repeated at each poll."""
        with contextlib.suppress(OSError):
            self._finish_mark.touch()

    def status(self) -> str:
        """Describes how the process ended, after `next` raised EOFError."""
        try:
            code = self._process.wait(timeout=_GRACE_S)
        except subprocess.TimeoutExpired:
            return "it closed its pipe and did not end"
        if code >= 0:
            return f"it left with exit status {code}"
        name = signal.Signals(-code).name
        why = ", most often the kernel's out-of-memory killer" if name == "SIGKILL" else ""
        return f"it was killed by {name}{why}"

    def kill(self) -> None:
        """Kills the process group; idempotent."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()
        self._process.wait()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as stream:
            for line in stream:
                with contextlib.suppress(ValueError, TypeError):  # a line cut off by the process's death
                    self._events.put(read_event(line))
        self._events.put(None)


def _start(job: Job, log: Path) -> subprocess.Popen[bytes]:
    environment = {**os.environ, PARENT_VARIABLE: str(os.getpid()), "OMP_WAIT_POLICY": "passive"}
    # A trainer reads untrusted data, and needs no database, store or cluster. The job carries the captioner's settings.
    secrets = tuple(environment_variable(Settings, name) for name in ("database_url", "database_password", "captioner"))
    for name in list(environment):
        if name.startswith((*secrets, "AWS_", "RAY_")):
            del environment[name]
    if job.settings.jobs.threads_per_job:
        environment["OMP_NUM_THREADS"] = str(job.settings.jobs.threads_per_job)
    with log.open("ab") as stderr:
        return subprocess.Popen(
            [sys.executable, "-m", "fastsplat.workers.engine.trainer"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stderr,
            env=environment,
            start_new_session=True,
        )
