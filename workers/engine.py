"""The job engine, DBOS Transact, behind four calls: its queue, who runs what, recovery. Nothing else imports it.

What it leaves to us: it does not notice dead executors (heartbeats), it does not know our trainers (killed by group,
and ended with their supervisor), and a suspended executor that continues is a second copy (every write carries its
attempt number). An idle worker, all of it, takes 0.9 % of a core on SQLite and 1.2 % on PostgreSQL.
"""

from __future__ import annotations

import logging
import sqlite3
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

import psycopg
from dbos import DBOS, DBOSConfig, SetWorkflowID
from sqlalchemy import URL, Engine, ExceptionContext, event

from fastsplat.service.store.database import connect
from fastsplat.service.store.records import OperationRecord
from fastsplat.workers.periodic import RepeatFilter

_QUEUE = "scenes"
_WORKFLOW = "make_scene"  # as in the rows of earlier releases
_APPLICATION_VERSION = "1"  # constant: a new release must find the jobs of the old one
_UNUSED_S = 60.0  # between looks for what our jobs never do: send, receive, run by a schedule
_BUSY_MS = 30_000
_ENDED = ("SUCCESS", "ERROR", "CANCELLED")
_MAX_DELETED_AT_ONCE = 1000


class JobEngine:
    """The engine of this process, one a process; it takes jobs from when it is made until the process ends.

    Args:
        url: of its database.
        executor_id: this worker.
        poll_interval_s: between looks into the queue.
        run: runs a job, in a thread of its own and one job at a time, given its id and how often it had been retried
            when it was queued. What it returns is kept with the engine's records. It must not raise, which would end
            the job for the engine; while it does not return, the job is this worker's.
    """

    def __init__(self, url: URL, executor_id: str, poll_interval_s: float, run: Callable[[str, int], str]) -> None:
        config: DBOSConfig = {
            "name": "fastsplat",
            "system_database_engine": open_database(url, sqlite3.sqlite_version_info),
            "application_version": _APPLICATION_VERSION,
            "executor_id": executor_id,
            "log_level": "WARNING",
            "run_migrations": True,
            "notification_listener_polling_interval_sec": _UNUSED_S,
            "notification_coalesce_sec": _UNUSED_S,  # by default it wakes a thread a hundred times a second
            "scheduler_polling_interval_sec": _UNUSED_S,
        }
        DBOS(config=config)
        _adopt_log()
        self._run = DBOS.workflow(name=_WORKFLOW, max_recovery_attempts=None)(run)
        DBOS.launch()
        DBOS.register_queue(
            _QUEUE, worker_concurrency=1, polling_interval_sec=poll_interval_s, on_conflict="always_update"
        )

    def enqueue(self, job: OperationRecord) -> None:
        """Hand a run of a job to whichever worker is free; the engine takes the id of a run only once."""
        with SetWorkflowID(job.run_id):
            DBOS.enqueue_workflow(_QUEUE, self._run, job.id, job.retries)

    def owners(self) -> Mapping[str, float]:
        """When the executors of unfinished jobs last took one, in seconds since 1970."""
        taken: dict[str, float] = {}
        for running in DBOS.list_workflows(status="PENDING", load_input=False, load_output=False):
            if running.executor_id:
                at = (running.updated_at or 0) / 1000
                taken[running.executor_id] = max(at, taken.get(running.executor_id, 0.0))
        return taken

    def requeue(self, executor_id: str) -> None:
        """Queue a dead executor's unfinished jobs again, those that no other has taken since.

        The engine does this by itself for an executor that starts again under the same id; for those that do not come
        back it leaves it to a hosted service, which makes the same internal call (dbos-inc/dbos-transact-py, issues 453
        and 716). `DBOS.resume_workflows` is public, and would queue a job again that another worker has just taken. A
        test pins the name down for the versions that the dependencies allow.
        """
        DBOS._recover_pending_workflows([executor_id])

    def forget(self, ended_before: float) -> None:
        """Remove the engine's own records of what ended before a moment, in seconds since 1970."""
        ended = DBOS.list_workflows(
            status=list(_ENDED),
            completed_before=datetime.fromtimestamp(ended_before, UTC).isoformat(),
            limit=_MAX_DELETED_AT_ONCE,
            load_input=False,
            load_output=False,
        )
        if ended:
            DBOS.delete_workflows([workflow.workflow_id for workflow in ended])


def open_database(url: URL, sqlite_version: tuple[int, ...]) -> Engine:
    """The engine's database, as the engine wants it.

    Args:
        url: of the database.
        sqlite_version: of the library.
    """
    engine = connect(url, pool_size=20, max_overflow=0)
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", _tune_sqlite)
        if sqlite_version < (3, 42):  # Debian 12 has 3.40, and any Python may have been built against either
            event.listen(engine, "connect", _provide_milliseconds)
    else:
        event.listen(engine, "handle_error", _mark_refused_connection)
    return engine


def _tune_sqlite(connection: Any, record: Any) -> None:
    connection.isolation_level = "IMMEDIATE"  # as where the engine opens its database itself
    for pragma in (f"busy_timeout={_BUSY_MS}", "journal_mode=WAL", "foreign_keys=ON"):
        connection.execute(f"PRAGMA {pragma}")


def _provide_milliseconds(connection: Any, record: Any) -> None:
    """Teach SQLite `unixepoch('subsec')`, from which the engine takes its times under Python 3.12 and later."""

    def unixepoch(modifier: str) -> float:
        if modifier != "subsec":
            raise ValueError(f"unixepoch of {modifier!r} is not provided")
        return round(time.time(), 3)

    connection.create_function("unixepoch", 1, unixepoch)


def _mark_refused_connection(context: ExceptionContext) -> None:
    """Have the engine try again whenever PostgreSQL cannot be reached.

    It tries again after errors whose text it knows, and raises the others, which ends the worker. A socket that is gone
    while the server restarts, and the name of a container that cannot be resolved meanwhile, are not among them. What
    it does know is SQLAlchemy's mark of a lost connection, so every connection that could not be made gets that.
    """
    if context.connection is None and isinstance(context.original_exception, psycopg.OperationalError):
        context.is_disconnect = True


def _adopt_log() -> None:
    """Have the engine's records go where this process's records go, in their form; it retries, and logs every try."""
    engine = logging.getLogger("dbos")
    for handler in list(engine.handlers):
        engine.removeHandler(handler)
    engine.addFilter(RepeatFilter(interval_s=10.0, length=30))
    engine.propagate = True
