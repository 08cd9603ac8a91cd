"""Schema migrations: a database of an earlier release becomes this release's; one that this release cannot read is
refused.

alembic runs them. To change the schema, change the tables in `service.store.schema` and add a file to `versions`, named
`vNNNN_what.py` by the next number, that does the same to a database of the number before it; SQLite needs
`op.batch_alter_table` for anything but new tables, columns and indexes. A new column has a default or is nullable.
A file that was released never changes. `tests/store/test_migrations.py` compares the files with the tables, column by
column, and says what a file has forgotten.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

from sqlalchemy import Connection, Engine, inspect, text

from fastsplat.service.store.schema import operations
from fastsplat_contract.errors import ConflictError

_SCRIPTS = Path(__file__).parent
_VERSION_TABLE = "alembic_version"
_ONLY_UNRELEASED = "schema_version"
"""A table that every version before the first release made."""
_LOCK = 0x46535057  # any number, the same for all processes that open one PostgreSQL database

_one_at_a_time = threading.Lock()  # alembic keeps the migration that runs in a global variable


Save = Callable[[Connection, Callable[[Connection], None]], None]
"""Saves what a database of an earlier release holds, given a connection to it, and what gives an empty database its
tables."""


def migrate(engine: Engine, scripts: Path = _SCRIPTS, save: Save | None = None) -> None:
    """Bring a database to the newest schema: all of it, or nothing. Several processes may do so at once.

    Args:
        engine: its transactions must take the write lock at their start, as `open_engine`'s do.
        scripts: the alembic folder; another one in tests.
        save: called before anything of an earlier release's database is changed; what it raises leaves it as it was.

    Raises:
        ConflictError: a later release wrote this database, or a version before the first release.
        ValueError: the database is of a version that never was.
        DBAPIError: the database does not answer.
    """
    newest = _newest(scripts)
    with engine.execution_options(read_only=True).connect() as connection:
        if _revision(connection, newest) == newest:
            return  # without the write lock, which somebody may hold for long
    with _one_at_a_time, engine.begin() as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
        stored = _revision(connection, newest)
        if save is not None and stored and stored < newest:
            save(connection, partial(_upgrade, scripts=scripts, newest=stored))
        _upgrade(connection, scripts, newest)


def revisions(connection: Connection) -> tuple[int, int]:
    """The schema version of a database, and this release's; 0 for a new database.

    Raises:
        ConflictError: this release cannot read it.
        ValueError: the database is of a version that never was.
    """
    newest = _newest(_SCRIPTS)
    return int(_revision(connection, newest) or 0), int(newest)


def _upgrade(connection: Connection, scripts: Path, newest: str) -> None:
    from alembic import command  # a database that is of this release already does without
    from alembic.config import Config

    config = Config(attributes={"connection": connection})
    config.set_main_option("script_location", str(scripts).replace("%", "%%"))
    command.upgrade(config, newest)


def _revision(connection: Connection, newest: str) -> str:
    """The revision that a database is of, four digits; "" for a new one."""
    tables = inspect(connection).get_table_names()
    if _ONLY_UNRELEASED in tables or (operations.name in tables and _VERSION_TABLE not in tables):
        raise ConflictError(
            "the database is of a version before the first release, which this one does not read",
            field="database_url",
            hint="To keep its scenes: export each as PLY or SPZ with the version that wrote it, start this release "
            "with an empty data folder and database, and import them there.",
        )
    if _VERSION_TABLE not in tables:
        return ""
    revision = str(connection.scalar(text(f"SELECT version_num FROM {_VERSION_TABLE}")))
    if not re.fullmatch(r"(?!0000)\d{4}", revision):
        raise ValueError(f"it is of a version that never was: {revision[:40]!r}")
    if revision > newest:
        raise ConflictError(
            f"the database is of version {int(revision)}, and this release knows versions up to {int(newest)}",
            field="database_url",
            hint="Start the release that wrote it, or a newer one; or restore a backup made before the upgrade.",
        )
    return revision


def _newest(scripts: Path) -> str:
    names = [path.name for path in (scripts / "versions").glob("v*.py")]
    return max(match[1] for name in names if (match := re.match(r"v(\d{4})_", name)))
