"""Schema migrations: a database of any earlier release becomes this release's; one of a later release is refused.

alembic runs them. To change the schema, change the tables in `service.store.schema` and add a file to `versions`, named
`vNNNN_what.py` by the next number, that does the same to a database of the number before it; SQLite needs
`op.batch_alter_table` for anything but new tables, columns and indexes. A new column has a default or is nullable.
Never change a file that was released. `tests/store/test_migrations.py` compares the files with the tables, column by
column, and says what a file has forgotten.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

from sqlalchemy import Connection, Engine, insert, inspect, text, update

from fastsplat.service.store.schema import operations, schema_version
from fastsplat_contract.errors import ConflictError

_SCRIPTS = Path(__file__).parent
_BEFORE_ALEMBIC = "0001"
"""The revision that every database without a revision has at least: what it lacks of the next, that adds."""
_LAST_BEFORE_ALEMBIC = "0002"
"""The revision whose tables have a place for everything in a database without one."""
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
        ConflictError: a later release wrote this database.
        ValueError: the database is of a version that never was.
        DBAPIError: the database does not answer.
    """
    newest = _newest(scripts)
    with engine.execution_options(read_only=True).connect() as connection:
        if _revision(connection) == newest:
            return  # without the write lock, which somebody may hold for long
    with _one_at_a_time, engine.begin() as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
        stored = _revision(connection)
        if stored is None and inspect(connection).has_table(operations.name):
            stored = _LAST_BEFORE_ALEMBIC
        if save is not None and stored is not None and _number(stored) < int(newest):
            save(connection, partial(_upgrade, scripts=scripts, newest=stored))
        _upgrade(connection, scripts, newest)


def revisions(connection: Connection) -> tuple[int, int]:
    """The schema version of a database, and this release's; 0 for a new database.

    Raises:
        ValueError: the database names no version.
    """
    stored = _revision(connection)
    if stored is None and inspect(connection).has_table(operations.name):
        stored = _BEFORE_ALEMBIC
    return _number(stored or "0"), int(_newest(_SCRIPTS))


def _upgrade(connection: Connection, scripts: Path, newest: str) -> None:
    from alembic import command  # a database that is of this release already does without
    from alembic.config import Config
    from alembic.util import CommandError

    revision = _revision(connection)
    if revision is not None and _number(revision) > int(newest):
        raise ConflictError(
            f"the database is of version {_number(revision)}, and this release knows versions up to {int(newest)}",
            field="database_url",
            hint="Start the release that wrote it, or a newer one; or restore a backup made before the upgrade.",
        )
    config = Config(attributes={"connection": connection})
    config.set_main_option("script_location", str(scripts).replace("%", "%%"))
    if revision is None and inspect(connection).has_table(operations.name):
        command.stamp(config, _BEFORE_ALEMBIC)
    try:
        command.upgrade(config, newest)
    except CommandError as error:
        raise ValueError(f"it is of a version that never was: {revision!r}") from error
    # Releases before alembic look here, and refuse a database of a later version.
    version = {"version": int(newest)}
    if not connection.execute(update(schema_version).values(version)).rowcount:
        connection.execute(insert(schema_version).values(version))


def _revision(connection: Connection) -> str | None:
    """The revision that a database is of; None for a new one, and for one of a release before alembic."""
    if not inspect(connection).has_table("alembic_version"):
        return None
    revision: str | None = connection.scalar(text("SELECT version_num FROM alembic_version"))
    return revision


def _number(revision: str) -> int:
    if not revision.isdecimal():
        raise ValueError(f"it is of a version that never was: {revision[:40]!r}")
    return int(revision)


def _newest(scripts: Path) -> str:
    names = [path.name for path in (scripts / "versions").glob("v*.py")]
    return max(match[1] for name in names if (match := re.match(r"v(\d{4})_", name)))
