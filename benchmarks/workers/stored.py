"""Seconds of processors that calls take with many scenes stored: of a PostgreSQL server, and of the caller."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Connection, Table, make_url, select, text

from benchmarks.workers.database_seconds import cpu_seconds
from fastsplat.service.store.repositories.quota_usage import reserve
from fastsplat.service.store.rows.schema import operations, scenes
from fastsplat.service.store.store import Store, open_store
from tests.postgres import PostgresServer
from tests.scenes import queued_job

_OF_PROJECT = 1_000  # scenes, as many as quotas allow by default
_UPLOADS = 100  # that lie in the store at once
_LEAST_S, _MOST_TIMES = 2.0, 20
_OLD_S = 30 * 86_400.0
_CHANGED: Mapping[Table, Mapping[str, str]] = {
    scenes: {"id": "md5('s' || i)", "operation_id": "md5('o' || i)", "state": "'READY'", "version": "md5('v' || i)"},
    operations: {
        "id": "md5('o' || i)", "scene_id": "md5('s' || i)", "state": "'SUCCEEDED'", "upload_id": "md5('u' || i)",
        "request_id": "NULL", "updated_at": "created_at - i",
    },
}  # fmt: skip


@dataclass(frozen=True)
class Seconds:
    """Seconds of processors that a call takes."""

    database: float
    caller: float


def stored_seconds(count: int) -> dict[str, Seconds]:
    """What calls take with so many finished scenes, a thousand a project: the mean of a few."""
    with (
        tempfile.TemporaryDirectory() as folder,
        closing(PostgresServer()) as server,
        server.database() as url,
        closing(open_store(Path(folder), _without_parallel_queries(url))) as store,
    ):
        _fill(store, count)
        return {name: _mean(server, call) for name, call in _calls(store).items()}


def _without_parallel_queries(url: str) -> str:
    """A URL by which each query has one process: several share memory that containers bound."""
    serial = make_url(url).update_query_dict({"options": "-c max_parallel_workers_per_gather=0"})
    return serial.render_as_string(hide_password=False)


def _fill(store: Store, count: int) -> None:
    """Copies of one scene and of its job, as rows; their lists are empty, as most calls do not read them."""
    store.scenes.create(queued_job())
    with store.engine.begin() as connection:
        for table, changed in _CHANGED.items():
            values = {"created_at": f"created_at - {_OLD_S} - i", "project": f"'p' || (i / {_OF_PROJECT})", **changed}
            columns = ", ".join(f'"{column.name}"' for column in table.c)
            copied = ", ".join(values.get(column.name, f'"{column.name}"') for column in table.c)
            series = f"generate_series(1, {count}) i"
            connection.execute(text(f"INSERT INTO {table} ({columns}) SELECT {copied} FROM {table}, {series}"))
        connection.execute(text("INSERT INTO quota_usage SELECT id, 1 FROM scenes"))
    with store.engine.execution_options(isolation_level="AUTOCOMMIT").connect() as connection:
        connection.execute(text("VACUUM ANALYZE"))


def _calls(store: Store) -> dict[str, Callable[[], object]]:
    with store.engine.begin() as connection:
        ids = list(connection.scalars(select(scenes.c.id)))
        uploads = list(connection.scalars(select(operations.c.upload_id).limit(_UPLOADS)))
    some = store.in_project("p0").scenes
    listed = some.list_scenes(1)[0].id

    def post() -> None:
        job = queued_job()

        def within(connection: Connection) -> None:
            reserve(connection, job.project, job.scene_id, 1)

        store.scenes.create(job, within)

    def minute() -> None:  # and `hour`: as workers/engine/cleanup.py
        store.jobs.over(())
        store.jobs.unneeded_uploads(uploads, 0.0)
        store.jobs.delete_ended(0.0)

    def hour() -> None:
        """With the names that a listing of the store would give."""
        store.jobs.lost_scenes(ids, 0.0)
        store.jobs.over(ids)
        store.versions.without_row(())

    return {
        "open": lambda: some.current_version(listed),
        "list": lambda: some.list_scenes(51),
        "claim": lambda: store.jobs.claim_next("nobody"),
        "post": post,
        "minute": minute,
        "hour": hour,
    }


def _mean(server: PostgresServer, call: Callable[[], object]) -> Seconds:
    call()
    caller, before, times = time.process_time(), cpu_seconds(server), 0
    while times < _MOST_TIMES and time.process_time() - caller + cpu_seconds(server) - before < _LEAST_S:
        call()
        times += 1
    return Seconds((cpu_seconds(server) - before) / times, (time.process_time() - caller) / times)
