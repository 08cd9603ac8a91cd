"""Seconds of processors, of a database and of who asks it, by the number of scenes that are stored."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from sqlalchemy import insert, select, text
from sqlalchemy.sql.expression import literal_column

from benchmarks.workers.database_clock import cpu_seconds
from fastsplat.service.application.admin.quotas import Quotas
from fastsplat.service.settings import QuotaSettings
from fastsplat.service.store.repositories.scene_repository import order_job
from fastsplat.service.store.rows.schema import operations, quota_usage, scenes
from fastsplat.service.store.store import Store, open_store
from tests.postgres import PostgresServer
from tests.scenes import finish_job, queued_job

_PAGE = 51
_OLD_S = 10 * 86_400.0


@dataclass(frozen=True)
class CallSeconds:
    """Seconds of processors that one call takes: of the database, and of its caller."""

    database: float
    caller: float


def measure_stored(count: int, repeats: int) -> Mapping[str, CallSeconds]:
    """What calls take of a PostgreSQL server with so many finished scenes of one project, medians aside: means."""
    with closing(PostgresServer()) as server, server.database() as url, tempfile.TemporaryDirectory() as folder:
        with closing(open_store(Path(folder), url)) as store:
            _fill(store, count)
            newest = store.scenes.list_scenes(1)[0]
            ids = [record.id for record in store.scenes.list_scenes(count)]
            return {
                name: _seconds(server, call, times)
                for name, (call, times) in _calls(store, newest.id, ids, repeats).items()
            }
