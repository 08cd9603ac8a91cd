"""The durable job engine (DBOS Transact) around the supervisor: queue, one recorded step a stage, recovery.

Our own rows are the truth about a job; the engine remembers which steps are done and who runs what. What it leaves to
us: it does not notice dead executors (heartbeats), it does not know our trainers (killed by group, and ended with their
supervisor), and a suspended executor that continues is a second copy (every write carries its attempt number).
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
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any, NoReturn

import psycopg
from dbos import DBOS, DBOSConfig, SetEnqueueOptions, SetWorkflowID, _workflow_commands
from sqlalchemy import Engine, ExceptionContext, event

from fastsplat.service.settings import Settings
from fastsplat.service.store.activity_clock import ActivityClock
from fastsplat.service.store.blobs import PARTIAL_EXPIRY_S
from fastsplat.service.store.database import IDLE_TRANSACTION_TIMEOUT_S, resolve_url
from fastsplat.service.store.job_repository import FencedError
from fastsplat.service.store.store import Store
from fastsplat.workers.claimed_job import DONE, JobOutcome, failed
from fastsplat.workers.cleanup import remove_unneeded, trash_lost_scenes, trash_lost_versions
from fastsplat.workers.heartbeat import Heartbeat, Observer, kill_suspended_workers, prune_stalled_workers
from fastsplat.workers.periodic import RepeatFilter, repeat
from fastsplat.workers.supervisor import StoppingError, Supervisor

_CLEANUP_INTERVAL_S = 60.0
"""How often a worker removes folders, uploads, logs and rows that are not needed any more."""

logger = logging.getLogger(__name__)

EXIT_FENCED = 75
"""Exit status of a worker whose job another worker has claimed: start it again (EX_TEMPFAIL)."""
_EXIT_FAILED = 70
_QUEUE = "scenes"
_APPLICATION_VERSION = "1"  # constant: a new release must find the jobs of the old one
_MIDDLE_PRIORITY = 2**30  # the engine counts from 1, and takes small numbers first
_STORAGE_CLEANUP_INTERVAL_S = 3600.0  # it may list a whole object store
_NOTIFICATIONS_S = 60.0  # our workflows neither send nor receive any
_HOUSEKEEPING_S = 4.0  # the engine holds a transaction open for so long, which PostgreSQL ends after 5 s
_ENDED = ("SUCCESS", "ERROR", "CANCELLED")
_MAX_DELETED_AT_ONCE = 1000


@dataclass
class Worker:
    """State of this process's worker: its identity, the jobs it runs, whether it is stopping."""

    store: Store
    settings: Settings
    stages: str
    executor_id: str = field(default_factory=lambda: f"{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex[:8]}")
    stopping: threading.Event = field(default_factory=threading.Event)
    running: dict[str, Supervisor] = field(default_factory=dict)
    heartbeats: Observer = field(default_factory=Observer)
    owners: Observer = field(default_factory=Observer)
    heartbeat: Heartbeat = field(init=False)

    def __post_init__(self) -> None:
        self.heartbeat = Heartbeat(self.store, self.executor_id, self.settings.jobs.stalled_worker_timeout_s)


_worker: Worker | None = None


def start(worker: Worker) -> None:
    """Launch the engine in this process and begin to take jobs; returns at once."""
    global _worker
    _worker = worker
    jobs = worker.settings.jobs
    # Before anything that writes: a suspended worker may hold the lock that a write waits for.
    _repeat(worker, "kill suspended workers", _kill_suspended, jobs.heartbeat_interval_s)
    worker.heartbeat.update()
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
        "sys_db_idle_transaction_timeout_sec": IDLE_TRANSACTION_TIMEOUT_S,
        "notification_listener_polling_interval_sec": _NOTIFICATIONS_S,
        "notification_coalesce_sec": _NOTIFICATIONS_S,  # by default it wakes a thread a hundred times a second
        "scheduler_polling_interval_sec": _NOTIFICATIONS_S,  # nor have we any schedules
    }
    provide_milliseconds(sqlite3.sqlite_version_info)
    retry_refused_connections()
    engine = DBOS(config=config)
    slow_down_housekeeping(engine)
    _adopt_engine_log()
    DBOS.launch()
    DBOS.register_queue(
        _QUEUE, worker_concurrency=1, polling_interval_sec=jobs.poll_interval_s, on_conflict="always_update"
    )
    remember_queues(engine._sys_db, _NOTIFICATIONS_S)
    _repeat(worker, "enqueue jobs", _enqueue_waiting, jobs.poll_interval_s)
    _repeat(worker, "update heartbeat", lambda worker: worker.heartbeat.update(), jobs.heartbeat_interval_s)
    _repeat(worker, "prune stalled workers", _prune_stalled, jobs.stalled_worker_timeout_s / 2)
    _repeat(worker, "check claims", _exit_if_fenced, jobs.heartbeat_interval_s)
    _repeat(worker, "cleanup", _clean_up, _CLEANUP_INTERVAL_S)
    _repeat(worker, "storage cleanup", _clean_up_storage, _STORAGE_CLEANUP_INTERVAL_S)


def stop(worker: Worker, patience_s: float = 15.0) -> None:
    """Give running jobs back. The process must end right after: the engine's workflows stay pending."""
    worker.stopping.set()
    deadline = time.monotonic() + patience_s
    while worker.running and time.monotonic() < deadline:
        time.sleep(0.05)
    worker.store.workers.mark_stopped(worker.executor_id)


@DBOS.workflow(name="make_scene", max_recovery_attempts=None)
def make_scene(operation_id: str, retries: int = 0) -> str:
    """Run one job from claim to end; runs again from its first unrecorded step after a crash.

    Args:
        operation_id: which job.
        retries: how often it had been retried when this run of it was queued; each run is a workflow of its own.

    Returns:
        How it ended, for the engine's records; "over" if it was cancelled in the queue or had ended before a crash.
    """
    worker = _this_worker()
    with _exits_on_failure(worker, operation_id):
        claim = worker.store.jobs.claim(operation_id, retries)
        if claim is None:
            return "over"
        supervisor = Supervisor(worker.store, worker.settings, claim, worker.stages, worker.stopping)
        worker.running[operation_id] = supervisor
        error = supervisor.start_limit_error()
        outcome = DONE if error is None else failed(error)
        for stage in supervisor.stages:
            if outcome == DONE:
                outcome = JobOutcome.from_json(_run_stage(operation_id, stage))
        supervisor.finish(outcome)
        del worker.running[operation_id]
        return outcome.state
    raise AssertionError("unreachable")


@DBOS.step(name="stage")
def _run_stage(operation_id: str, stage: str) -> dict[str, Any]:
    worker = _this_worker()
    with _exits_on_failure(worker, operation_id):
        return worker.running[operation_id].run_stage(stage).to_json()
    raise AssertionError("unreachable")


@contextmanager
def _exits_on_failure(worker: Worker, operation_id: str) -> Iterator[None]:
    """Let no exception reach the engine, which would record it as the end of the job; the job must stay pending."""
    try:
        yield
    except StoppingError:
        worker.running.pop(operation_id, None)
        _block_forever()
    except FencedError:
        _exit_fenced(worker, operation_id)
    except Exception:
        logger.exception("job %s: the worker cannot go on", operation_id)
        _exit_worker(worker, _EXIT_FAILED)


def _block_forever() -> NoReturn:
    while True:
        time.sleep(3600)


def _exit_worker(worker: Worker, status: int) -> NoReturn:
    for supervisor in list(worker.running.values()):
        supervisor.kill()
    logging.shutdown()
    os._exit(status)


def _exit_fenced(worker: Worker, operation_id: str) -> NoReturn:
    logger.warning("job %s has been claimed by another worker; this worker starts over", operation_id)
    _exit_worker(worker, EXIT_FENCED)


def _this_worker() -> Worker:
    assert _worker is not None
    while _worker.stopping.is_set() and not _worker.running:
        time.sleep(3600)  # taken from the queue while stopping: the job must stay pending
    return _worker


def _repeat(worker: Worker, name: str, task: Callable[[Worker], None], interval_s: float) -> None:
    repeat(name, lambda: None if worker.stopping.is_set() else task(worker), interval_s)


def _enqueue_waiting(worker: Worker) -> None:
    # An operation is acknowledged by its row alone; from there it reaches the engine here, once or several times:
    # the engine takes the id of a run only once.
    live_since = time.time() - worker.settings.jobs.stalled_worker_timeout_s
    for job in worker.store.jobs.due(live_since):
        with SetWorkflowID(job.run_id), SetEnqueueOptions(priority=_MIDDLE_PRIORITY - job.priority):
            DBOS.enqueue_workflow(_QUEUE, make_scene, job.id, job.retries)
        worker.store.jobs.mark_enqueued(job.id, job.retries)


def provide_milliseconds(sqlite_version: tuple[int, ...]) -> None:
    """Teach an older SQLite `unixepoch('subsec')`, to be called before the engine opens its database.

    From Python 3.12 on the engine takes its times from it; SQLite knows it from 3.42 on, Debian 12 has 3.40, and any
    Python may have been built against either.
    """
    if sqlite_version >= (3, 42):
        return

    def unixepoch(modifier: str) -> float:
        if modifier != "subsec":
            raise ValueError(f"unixepoch of {modifier!r} is not provided")
        return round(time.time(), 3)

    @event.listens_for(Engine, "connect")
    def on_connect(connection: object, record: object) -> None:
        if isinstance(connection, sqlite3.Connection):
            connection.create_function("unixepoch", 1, unixepoch)


def retry_refused_connections() -> None:
    """Have the engine try again whenever PostgreSQL cannot be reached, to be called before it opens its database.

    It tries again after errors whose text it knows, and raises the others, which ends the worker. A socket that is gone
    while the server restarts, and the name of a container that cannot be resolved meanwhile, are not among them. What
    it does know is SQLAlchemy's mark of a lost connection, so every connection that could not be made gets that.
    """
    event.listen(Engine, "handle_error", _mark_refused_connection)


def _mark_refused_connection(context: ExceptionContext) -> None:
    if context.connection is None and isinstance(context.original_exception, psycopg.OperationalError):
        context.is_disconnect = True


def slow_down_housekeeping(engine: DBOS) -> None:
    """Have the engine look less often for work that it never gets here; to be called before its launch.

    Each second it looks for jobs of its own queue, for delayed workflows and for those past their deadline. We have
    none, and an idle worker spends most of its time on that. There is no setting for it; a test pins down the names for
    the versions that the dependencies allow.
    """
    engine._registry.get_internal_queue()._polling_interval_sec = _NOTIFICATIONS_S
    _workflow_commands._BACKGROUND_JOBS_INTERVAL_SEC = _HOUSEKEEPING_S


def remember_queues(database: Any, interval_s: float) -> None:
    """Have the engine's database answer `list_queues` from memory for `interval_s` seconds, once there are any.

    A thread of the engine asks each second whether there are new queues. There is ours, and it never changes.
    """
    list_queues, listed_at = database.list_queues, 0.0
    queues: list[Any] = []

    def remembered(*, application_name: str) -> list[Any]:
        nonlocal queues, listed_at
        if not queues or time.monotonic() - listed_at > interval_s:
            queues, listed_at = list_queues(application_name=application_name), time.monotonic()
        return list(queues)

    database.list_queues = remembered


def _adopt_engine_log() -> None:
    """Have the engine's records go where this process's records go, in their form; it retries, and logs every try."""
    engine = logging.getLogger("dbos")
    for handler in list(engine.handlers):
        engine.removeHandler(handler)
    engine.addFilter(RepeatFilter(interval_s=10.0, length=30))
    engine.propagate = True


def _kill_suspended(worker: Worker) -> None:
    timeout_s = worker.settings.jobs.stalled_worker_timeout_s
    kill_suspended_workers(worker.store, worker.executor_id, worker.heartbeats, timeout_s)


def _prune_stalled(worker: Worker) -> None:
    timeout_s, regular = worker.settings.jobs.stalled_worker_timeout_s, worker.heartbeat.is_regular()
    prune_stalled_workers(
        worker.store, worker.executor_id, worker.heartbeats, worker.owners, timeout_s, trust_timeout=regular
    )


def _exit_if_fenced(worker: Worker) -> None:
    for operation_id, supervisor in list(worker.running.items()):
        if supervisor.is_lost() and operation_id in worker.running:
            _exit_fenced(worker, operation_id)


def _clean_up(worker: Worker) -> None:
    settings = worker.settings
    uploads, retention_s = settings.uploads, settings.jobs.ended_job_retention_s
    remove_unneeded(worker.store, uploads.expiry_s, retention_s, uploads.failed_retention_s)
    trash_lost_scenes(worker.store, ActivityClock(worker.store.blobs.root).now())
    _delete_engine_records(retention_s)


def _clean_up_storage(worker: Worker) -> None:
    blobs = worker.store.blobs
    blobs.remove_partial(PARTIAL_EXPIRY_S)
    trash_lost_versions(worker.store, min(time.time(), ActivityClock(blobs.root).now()))


def _delete_engine_records(retention_s: float) -> None:
    """Remove the engine's own records of what ended so long ago."""
    before = datetime.now(UTC) - timedelta(seconds=retention_s)
    ended = DBOS.list_workflows(
        status=list(_ENDED),
        completed_before=before.isoformat(),
        limit=_MAX_DELETED_AT_ONCE,
        load_input=False,
        load_output=False,
    )
    if ended:
        DBOS.delete_workflows([workflow.workflow_id for workflow in ended])
