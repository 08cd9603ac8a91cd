"""Schema: a database of the first release becomes this release's, with everything in it; none goes back."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import Column, Connection, Engine, Integer, String, Table, inspect, text
from sqlalchemy.schema import MetaData

from fastsplat.service.store import Store, open_store
from fastsplat.service.store.engine import open_engine, resolve_url
from fastsplat.service.store.migrations import STEPS, add_column, migrate
from fastsplat.service.store.schema import metadata
from fastsplat_contract.errors import ConflictError

_FIRST_RELEASE = Path(__file__).with_name("first_release.sql").read_text()


@pytest.fixture
def old(tmp_path: Path, database_url: str) -> Iterator[Engine]:
    """A database as the first release left it."""
    engine = open_engine(resolve_url(tmp_path, database_url, sqlite_name="fastsplat.sqlite"))
    sql = _FIRST_RELEASE if database_url else _FIRST_RELEASE.replace("DOUBLE PRECISION", "DOUBLE")
    with engine.begin() as connection:
        metadata.drop_all(connection)
        for statement in sql.split(";\n"):
            if statement.strip():
                connection.execute(text(statement))
    yield engine
    engine.dispose()


def _shape(engine: Engine) -> dict[str, Any]:
    """Everything that a schema promises; defaults aside, which steps need and new tables may not."""
    tables = inspect(engine)
    return {
        name: (
            {c["name"]: (repr(c["type"]), c["nullable"]) for c in tables.get_columns(name)},
            tables.get_pk_constraint(name)["constrained_columns"],
            sorted(tuple(i["column_names"]) for i in tables.get_indexes(name)),
            sorted(tuple(u["column_names"]) for u in tables.get_unique_constraints(name)),
        )
        for name in tables.get_table_names()
    }


def test_the_first_releases_database_becomes_the_same_as_a_new_one(old):
    migrate(old)
    migrated = _shape(old)
    with old.begin() as connection:
        metadata.drop_all(connection)
    migrate(old)
    assert migrated == _shape(old)
    assert set(migrated) == set(metadata.tables)


def test_what_the_first_release_stored_is_there_and_goes_on(old, tmp_path, database_url):
    store = open_store(tmp_path, database_url)
    scene = store.rows.scene("done")
    assert (scene.name, scene.state, scene.gaussians, scene.quality) == ("desk", "READY", 7, {"psnr": 30.0})
    assert store.rows.operation("op_done").priority == 0
    assert list(store.jobs.waiting()) == [("op_new", 0)]
    claim = store.jobs.claim("op_new")
    assert claim is not None and claim.operation.options["labels"] == ["mug"]
    store.close()


def test_opening_twice_and_by_many_at_once_changes_nothing_more(old, tmp_path, database_url):
    barrier = threading.Barrier(6)

    def open_it(_: int) -> Store:
        barrier.wait()
        return open_store(tmp_path, database_url)

    with ThreadPoolExecutor(6) as pool:
        stores = list(pool.map(open_it, range(6)))
    for store in stores:
        assert len(store.rows.scenes(10)) == 2
        store.close()
    with old.connect() as connection:
        assert connection.scalar(text("SELECT count(*) FROM schema_version")) == 1


def test_a_database_of_a_later_release_is_refused_unchanged(old, tmp_path, database_url):
    migrate(old)
    with old.begin() as connection:
        connection.execute(text("UPDATE schema_version SET version = 1000"))
    with pytest.raises(ConflictError, match="1000") as caught:
        open_store(tmp_path, database_url)
    assert caught.value.hint
    with old.connect() as connection:
        assert connection.scalar(text("SELECT version FROM schema_version")) == 1000


def test_a_step_that_fails_leaves_the_database_as_it_was(old):
    def bad(connection: Connection) -> None:
        connection.execute(text("ALTER TABLE scenes ADD COLUMN half INTEGER"))
        raise RuntimeError("a defect")

    before = _shape(old)
    with pytest.raises(RuntimeError, match="a defect"):
        migrate(old, (*STEPS, bad))
    assert _shape(old) == before


def test_every_step_runs_once_and_in_order(old):
    calls: list[int] = []
    steps = (*STEPS, lambda _: calls.append(1), lambda _: calls.append(2))
    migrate(old)
    migrate(old, steps[:-1])
    migrate(old, steps)
    migrate(old, steps)
    assert calls == [1, 2]


def test_a_column_is_added_as_the_schema_has_it_and_left_to_tables_that_are_to_come(old):
    column = Column("colour", String(7), nullable=False, server_default="grey")
    Table("scenes", MetaData(), Column("id", Integer), column)
    absent = Column("colour", String(7))
    Table("not_there_yet", MetaData(), absent)
    with old.begin() as connection:
        add_column(connection, column)
        add_column(connection, absent)
    with old.connect() as connection:
        assert connection.scalars(text("SELECT DISTINCT colour FROM scenes")).all() == ["grey"]
