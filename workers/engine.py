"""The durable job engine (DBOS Transact) around the supervisor: queue, one recorded step a stage, recovery.

Our own rows are the truth about a job; the engine remembers which steps are done and who runs what. What it leaves to
us: it does not notice dead executors (beats and a sweep), it does not know our trainers (killed by group, die with
their supervisor), and a frozen executor that wakes is a second copy (every write carries its attempt number).
A worker that cannot go on as planned ends itself: recovery by another, or by itself anew, is the one way back.
"""

from __future__ import annotations

import logging
import os
import socket
import sqlite3
import threading
import time
import uuid
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

from dbos import DBOS, DBOSConfig, SetEnqueueOptions, SetWorkflowID

from fastsplat.service.common.progress import STAGES
from fastsplat.service.settings import Settings
from fastsplat.service.store import Store
from fastsplat.service.store.engine import IDLE_TRANSACTION_S, resolve_url
from fastsplat.service.store.jobs import FencedError
from fastsplat.workers.janitor import clean
from fastsplat.workers.supervisor import DONE, StoppingError, Supervisor
from fastsplat.workers.sweep import Pulse, kill_frozen, sweep

logger = logging.getLogger(__name__)

FENCED_EXIT = 75
"""Exit status of a worker that found its job in other hands: start it again (EX_TEMPFAIL)."""
_CRASH_EXIT = 70
_QUEUE = "scenes"
_APPLICATION_VERSION = "1"  # constant: a new release must find the jobs of the old one
_MIDDLE_PRIORITY = 2**30  # the engine counts from 1, and takes small numbers first
_ALIKE_CHARS, _ALIKE_S = 30, 10.0
_JANITOR_S = 60.0
_TIDY_S = 3600.0  # it may list a whole object store
_ENDED = ("SUCCESS", "ERROR", "CANCELLED")
_FORGET_AT_ONCE = 1000
_AFTER_TROUBLE_S = 1.0


@dataclass
class Worker:
    """This process's one worker: who it is, what it runs, whether it is leaving."""

    store: Store
    settings: Settings
    stages: str
    executor_id: str = field(default_factory=lambda: f"{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex[:8]}")
    stopping: threading.Event = field(default_factory=threading.Event)
    running: dict[str, Supervisor] = field(default_factory=dict)
    pulse: Pulse = field(init=False)

    def __post_init__(self) -> None:
        self.pulse = Pulse(self.store, self.executor_id, self.settings.jobs.stale_s)


_worker: Worker | None = None


def start(worker: Worker) -> None:
    """Launch the engine in this process and begin to take jobs; returns at once."""
    global _worker
    _worker = worker
    jobs = worker.settings.jobs
    # Before anything that writes: a frozen worker may hold the lock that a write waits for.
    _start_thread(worker, "frozen", _kill_frozen, jobs.beat_s)
    worker.pulse.beat()
    url = resolve_url(worker.settings.data_dir, worker.settings.database_url, sqlite_name="jobs.sqlite")
    if url.get_backend_name() == "sqlite" and url.database:
        with closing(sqlite3.connect(url.database, timeout=30)) as connection:
            connection.execute("PRAGMA journal_mode=WAL")  # a property of the file, so once is enough
    config: DBOSConfig = {
        "name": "fastsplat",
        "system_database_url": url.render_as_string(hide_password=False),
        "application_version": _APPLICATION_VERSION,
        "executor_id": worker.executor_id,
        "log_level": "WARNING",
        "run_migrations": True,
        "sys_db_idle_transaction_timeout_sec": IDLE_TRANSACTION_S,
    }
    DBOS(config=config)
    _share_log()
    DBOS.launch()
    DBOS.register_queue(
        _QUEUE,
        worker_concurrency=1,
        polling_interval_sec=worker.settings.jobs.poll_s,
        on_conflict="always_update",
    )
    for name, act, pause in (
        ("dispatch", _dispatch, jobs.poll_s),
        ("beat", _beat, jobs.beat_s),
        ("sweep", _sweep, jobs.beat_s),
        ("fence", _leave_if_lost, jobs.beat_s),
        ("janitor", _clean, _JANITOR_S),
        ("tidy", _tidy, _TIDY_S),
    ):
        _start_thread(worker, name, act, pause)


def stop(worker: Worker, patience_s: float = 15.0) -> None:
    """Give running jobs back and say goodbye. The process must end right after: its workflows stay pending."""
    worker.stopping.set()
    deadline = time.monotonic() + patience_s
    while worker.running and time.monotonic() < deadline:
        time.sleep(0.05)
    worker.store.jobs.resign(worker.executor_id)


@DBOS.workflow(name="make_scene", max_recovery_attempts=None)
def make_scene(operation_id: str) -> str:
    """One job from claim to end; runs again from its first unrecorded step after a crash."""
    worker = _this_worker()
    try:
        claim = worker.store.jobs.claim(operation_id)
        if claim is None:
            return "over"  # cancelled in the queue, or finished just before a crash
        supervisor = Supervisor(worker.store, worker.settings, claim, worker.stages, worker.stopping)
        worker.running[operation_id] = supervisor
        parked = supervisor.parked()
        outcome: Mapping[str, Any] = {"outcome": "failed", "error": parked} if parked else DONE
        for stage in STAGES:
            if outcome["outcome"] != "done":
                break
            outcome = _run_stage(operation_id, stage)
        supervisor.finish(outcome)
        del worker.running[operation_id]
        return str(outcome["outcome"])
    except StoppingError:
        worker.running.pop(operation_id, None)
        return _hold()
    except FencedError:
        logger.warning("job %s is in other hands; this worker starts over", operation_id)
        return _leave(worker, FENCED_EXIT)
    except Exception:
        logger.exception("job %s: the worker cannot go on", operation_id)
        return _leave(worker, _CRASH_EXIT)


@DBOS.step(name="stage")
def _run_stage(operation_id: str, stage: str) -> dict[str, Any]:
    worker = _this_worker()
    try:
        return dict(worker.running[operation_id].run_stage(stage))
    except StoppingError:
        worker.running.pop(operation_id, None)
        _hold()
    except FencedError:
        logger.warning("job %s is in other hands; this worker starts over", operation_id)
        _leave(worker, FENCED_EXIT)
    except Exception:
        logger.exception("job %s: the worker cannot go on", operation_id)
        _leave(worker, _CRASH_EXIT)
    raise AssertionError("unreachable")


def _hold() -> str:
    # Returning or raising would be recorded as the job's end; it must stay pending until this process is gone.
    while True:
        time.sleep(3600)


def _leave(worker: Worker, status: int) -> str:
    for supervisor in list(worker.running.values()):
        supervisor.kill()
    logging.shutdown()
    os._exit(status)


def _this_worker() -> Worker:
    assert _worker is not None
    while _worker.stopping.is_set() and not _worker.running:
        time.sleep(3600)  # taken from the queue while leaving: as `_hold`
    return _worker


def _start_thread(worker: Worker, name: str, act: Callable[[Worker], None], pause: float) -> None:
    threading.Thread(target=_forever, args=(worker, act, pause), name=name, daemon=True).start()


def _forever(worker: Worker, act: Callable[[Worker], None], pause: float) -> None:
    while True:
        try:
            if not worker.stopping.is_set():
                act(worker)
        except Exception as error:  # the database may be away for a while
            logger.warning("%s: %s", threading.current_thread().name, type(error).__name__)
            time.sleep(_AFTER_TROUBLE_S)
        time.sleep(pause)


def _dispatch(worker: Worker) -> None:
    # An operation is acknowledged by its row alone; from there it reaches the engine here, once or several times:
    # the engine takes an operation id only once.
    for operation_id, priority in worker.store.jobs.waiting():
        with SetWorkflowID(operation_id), SetEnqueueOptions(priority=_MIDDLE_PRIORITY - priority):
            DBOS.enqueue_workflow(_QUEUE, make_scene, operation_id)
        worker.store.jobs.mark_enqueued(operation_id)


def _share_log() -> None:
    """Have the engine's records go where this process's records go, in their form."""
    engine = logging.getLogger("dbos")
    for handler in list(engine.handlers):
        engine.removeHandler(handler)
    engine.addFilter(_Sparse())
    engine.propagate = True


class _Sparse(logging.Filter):
    """Lets a record through that begins as one of a moment ago only now and then: the engine retries, and tells."""

    def __init__(self) -> None:
        super().__init__()
        self._last: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        beginning, now = record.getMessage()[:_ALIKE_CHARS], time.monotonic()
        if now - self._last.get(beginning, -_ALIKE_S) < _ALIKE_S:
            return False
        self._last[beginning] = now
        return True


def _beat(worker: Worker) -> None:
    worker.pulse.beat()


def _kill_frozen(worker: Worker) -> None:
    kill_frozen(worker.store, worker.executor_id, worker.settings.jobs.stale_s)


def _leave_if_lost(worker: Worker) -> None:
    for operation_id, supervisor in list(worker.running.items()):
        if supervisor.lost() and operation_id in worker.running:
            logger.warning("job %s is in other hands; this worker starts over", operation_id)
            _leave(worker, FENCED_EXIT)


def _sweep(worker: Worker) -> None:
    sweep(worker.store, worker.executor_id, worker.settings.jobs.stale_s, judge=worker.pulse.may_judge())


def _clean(worker: Worker) -> None:
    clean(worker.store, worker.settings.store.abandoned_upload_s, worker.settings.jobs.keep_ended_s)
    _forget(worker.settings.jobs.keep_ended_s)


def _tidy(worker: Worker) -> None:
    worker.store.blobs.tidy(worker.settings.store.abandoned_upload_s)


def _forget(keep_s: float) -> None:
    """Remove the engine's own records of what ended so long ago."""
    before = datetime.now(UTC) - timedelta(seconds=keep_s)
    ended = DBOS.list_workflows(
        status=list(_ENDED),
        completed_before=before.isoformat(),
        limit=_FORGET_AT_ONCE,
        load_input=False,
        load_output=False,
    )
    if ended:
        DBOS.delete_workflows([workflow.workflow_id for workflow in ended])
