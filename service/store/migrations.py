"""The database grows with the product: a folder of any earlier release opens, one of a later release is refused.

How to change the schema:

- A new table: define it on `service.store.schema.metadata`, in a module that `service.store` imports. Tables that are
  missing are made at every opening; write no step.
- A new column or index of an existing table: change the table, and append a function to `STEPS` that does the same to
  a database that has the old one, through `add_column` and the like. Such columns are nullable or have a default.

Never change or reorder a step that was released. The test in `tests/store/test_migrations.py` opens a database of the
first release and holds its schema against a new one's, column by column; it fails when a step was forgotten.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from sqlalchemy import Column, Connection, Engine, Index, Integer, Table, insert, inspect, select, text, update
from sqlalchemy.schema import CreateColumn

from fastsplat.service.store.schema import metadata, operations
from fastsplat_contract.errors import ConflictError

Step = Callable[[Connection], None]

_FIRST = 1  # the schema before versions were counted
_LOCK = 0x46535057  # any number, the same for all processes that open one PostgreSQL database

_schema_version = Table("schema_version", metadata, Column("version", Integer, primary_key=True, autoincrement=False))


def _jobs_have_a_priority(connection: Connection) -> None:
    add_column(connection, operations.c.priority)


STEPS: tuple[Step, ...] = (_jobs_have_a_priority,)
"""Step n takes a database from version n to n + 1, counted from 1."""


def migrate(engine: Engine, steps: Sequence[Step] = STEPS) -> None:
    """Bring a database to the newest schema: all of it, or nothing. Several processes may do so at once.

    Args:
        engine: its transactions must take the write lock at their start, as `open_engine`'s do.
        steps: the product's, but for tests.

    Raises:
        ConflictError: a later release wrote this database.
        DBAPIError: the database does not answer.
    """
    newest = _FIRST + len(steps)
    if _is_new(engine, newest):
        return  # without the write lock, which somebody may hold for long
    with engine.begin() as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
        found = _version(connection, newest)
        if found > newest:
            raise ConflictError(
                f"the database is of version {found}, and this release knows versions up to {newest}",
                field="database_url",
                hint="Start the release that wrote it, or a newer one; or restore a backup made before the upgrade.",
            )
        for step in steps[found - _FIRST :]:
            step(connection)
        metadata.create_all(connection)
        if not connection.execute(update(_schema_version).values(version=newest)).rowcount:
            connection.execute(insert(_schema_version).values(version=newest))


def add_column(connection: Connection, column: Column[Any]) -> None:
    """Add a column as the schema has it, unless the table is yet to be made, which will make it whole."""
    if not inspect(connection).has_table(column.table.name):
        return
    compiler = connection.dialect.ddl_compiler(connection.dialect, None)  # type: ignore[arg-type]
    definition = compiler.process(CreateColumn(column))
    connection.execute(text(f"ALTER TABLE {column.table.name} ADD COLUMN {definition}"))


def add_index(connection: Connection, index: Index) -> None:
    """Add an index as the schema has it, unless the table is yet to be made."""
    assert index.table is not None
    if inspect(connection).has_table(index.table.name):
        index.create(connection)


def _is_new(engine: Engine, newest: int) -> bool:
    with engine.execution_options(read_only=True).connect() as connection:
        tables = set(inspect(connection).get_table_names())
        return set(metadata.tables) <= tables and connection.scalar(select(_schema_version.c.version)) == newest


def _version(connection: Connection, newest: int) -> int:
    tables = inspect(connection)
    if tables.has_table(_schema_version.name):
        version = connection.scalar(select(_schema_version.c.version))
        if version is not None:
            return int(version)
    return _FIRST if tables.has_table(operations.name) else newest
