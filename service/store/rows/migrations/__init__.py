"""Schema migrations by alembic, from databases of earlier releases to this one's.

To change the schema, change the tables in `schema` and add a file to `versions`, named `vNNNN_what.py` by
the next number, that does the same to a database of the number before. SQLite needs `op.batch_alter_table` for anything
but new tables, columns and indexes. New columns have a default or are nullable. Released files never change.
`tests/store/test_migrations.py` compares files and tables column by column.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

from sqlalchemy import Connection, Engine, inspect, text

from fastsplat.service.store.rows.schema import operations
from fastsplat_contract.errors import ConflictError

_SCRIPTS = Path(__file__).parent
_VERSION_TABLE = "alembic_version"
_FIRST = "0003"  # numbers below it, and databases without one, are of versions before the first release
_LOCK = 0x46535057  # arbitrary, but the same for all processes

_one_at_a_time = threading.Lock()  # alembic keeps the migration that runs in a global variable


Save = Callable[[Connection, Callable[[Connection], None]], None]
"""Saves an older database: (its connection, function that makes its tables in an empty one)."""


def migrate(engine: Engine, scripts: Path = _SCRIPTS, save: Save | None = None) -> None:
    """Brings a database to the newest schema in one transaction; safe from several processes.

    Args:
        engine: takes the write lock at the start of transactions, as from `open_engine`.
        scripts: the alembic folder.
        save: called before an older database is changed; if it raises, nothing is.

    Raises:
        ConflictError: a later release wrote this database, or a version before the first release.
        ValueError: the database has an impossible revision.
        DBAPIError: the database does not answer.
    """
    newest = _newest(scripts)
    with engine.execution_options(read_only=True).connect() as connection:
        if _revision(connection, newest) == newest:
            return  # without the write lock, which may be held for long
    with _one_at_a_time, engine.begin() as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
        stored = _revision(connection, newest)
        if save is not None and stored and stored < newest:
            save(connection, partial(_upgrade, scripts=scripts, newest=stored))
        _upgrade(connection, scripts, newest)


def revisions(connection: Connection) -> tuple[int, int]:
    """Returns the schema version of a database (0: new) and this release's; errors as `migrate`."""
    newest = _newest(_SCRIPTS)
    return int(_revision(connection, newest) or 0), int(newest)


def _upgrade(connection: Connection, scripts: Path, newest: str) -> None:
    from alembic import command  # imported only if there is something to upgrade
    from alembic.config import Config

    config = Config(attributes={"connection": connection})
    config.set_main_option("script_location", str(scripts).replace("%", "%%"))
    command.upgrade(config, newest)


def _revision(connection: Connection, newest: str) -> str:
    """Returns the revision of a database, four digits; "" for a new one."""
    tables = inspect(connection).get_table_names()
    if _VERSION_TABLE not in tables and operations.name not in tables:
        return ""
    bears = _VERSION_TABLE in tables
    revision = str(connection.scalar(text(f"SELECT version_num FROM {_VERSION_TABLE}"))) if bears else "0001"
    if not re.fullmatch(r"(?!0000)\d{4}", revision):
        raise ValueError(f"it is of a version that never was: {revision[:40]!r}")
    if revision < _FIRST:
        raise ConflictError(
            "the database is of a version before the first release, which this one does not read",
            field="database_url",
            hint="To keep its scenes: export each as PLY or SPZ with the version that wrote it, start this release "
            "with an empty data folder and database, and import them there.",
        )
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
