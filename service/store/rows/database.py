"""Database engines and transactions, with SQLite set up for several processes."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Column, ColumnElement, Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, DataError, DBAPIError, IntegrityError, SQLAlchemyError

from fastsplat.service.store.rows.damaged_rows import read_json
from fastsplat.service.store.rows.migrations import Save, migrate
from fastsplat_contract.errors import DatabaseError, InvalidInputError

_BUSY_MS = 30_000
_DAMAGE = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_DAMAGE_HINT = "Run: fastsplat doctor. Then restore a backup."
_PRIMARY_CODE = 0xFF  # mask of the primary part of SQLite's extended error codes

IDLE_TRANSACTION_TIMEOUT_S = 30.0
"""PostgreSQL's limit for an idle transaction, so that a suspended process loses its locks."""
_POSTGRES: Mapping[str, Any] = {
    # Notices within half a minute that a server vanished without closing its connections.
    "connect_timeout": 10, "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 4,
    "tcp_user_timeout": 30_000,
}  # fmt: skip


SQLITE_NAME = "fastsplat.sqlite"
"""File name of the database in a data folder."""


def resolve_url(data_dir: Path, database_url: str) -> URL:
    """Reads a database URL (empty: SQLite in the folder); may raise `InvalidInputError`."""
    if not database_url:
        return URL.create("sqlite", database=str(data_dir.resolve() / SQLITE_NAME))
    try:
        url = make_url(database_url)
    except ArgumentError as error:
        raise InvalidInputError(
            "the database URL cannot be read",
            field="database_url",
            hint="Write it as postgresql://user:password@host:5432/name, or leave it empty for SQLite.",
        ) from error
    return url.set(drivername="postgresql+psycopg") if url.drivername in ("postgres", "postgresql") else url


def open_engine(url: URL, save: Save | None = None) -> Engine:
    """Opens an engine and brings its tables to this release's schema.

    SQLite transactions begin IMMEDIATE unless the connection has the option `read_only`: one that begins as a reader
    and then writes fails with "locked" at once, whatever the busy timeout.
    """
    options: dict[str, Any] = {"pool_size": 8, "max_overflow": 24, "json_deserializer": read_json}
    if url.get_backend_name() == "sqlite":
        engine = create_engine(url, **options)
        event.listen(engine, "connect", _tune_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
    else:
        engine = create_engine(url, pool_pre_ping=True, connect_args=dict(_POSTGRES), **options)
        event.listen(engine, "connect", _tune_postgres)
    _open_tables(engine, save)
    return engine


@contextmanager
def transaction(engine: Engine) -> Iterator[Connection]:
    """Runs the block in a transaction, committed at its end.

    Raises:
        DatabaseError: the database does not answer, or refuses.
        InvalidInputError: it cannot hold a value: a lone surrogate, a NUL, too large a number.
        IntegrityError: a constraint does not hold.
    """
    try:
        with engine.begin() as connection:
            yield connection
    except IntegrityError:
        raise
    except (UnicodeEncodeError, DataError) as error:
        raise InvalidInputError(
            "a value that the database cannot hold", hint="Send plain Unicode text without NUL, and usual numbers."
        ) from error
    except SQLAlchemyError as error:
        code = _sqlite_code(error)
        if code in _DAMAGE:
            raise _damaged() from error
        if code == sqlite3.SQLITE_READONLY:
            raise DatabaseError(
                "the database cannot be written: its disk is read-only",
                hint="Mount the data folder's disk for writing.",
            ) from error
        if code == sqlite3.SQLITE_FULL:
            raise DatabaseError(
                "the disk of the database is full", hint="Delete scenes that are not needed any more, or free space."
            ) from error
        raise DatabaseError(f"the database does not answer ({type(error).__name__})") from error
    except UnicodeDecodeError as error:
        raise _damaged() from error


class Repository:
    """Base of what reads and writes rows, for any thread."""

    def __init__(self, engine: Engine) -> None:
        self._writing = partial(transaction, engine)
        self._reading = partial(transaction, engine.execution_options(read_only=True))


def upsert(connection: Connection, row: Mapping[Column[Any], Any], only: ColumnElement[bool] | None = None) -> bool:
    """Inserts a row, or updates that of the same primary key if `only` holds there; False if it does not."""
    dialect = import_module(f"sqlalchemy.dialects.{connection.dialect.name}")
    values = {column.name: value for column, value in row.items()}
    table = next(iter(row)).table
    statement = dialect.insert(table).values(values)
    statement = statement.on_conflict_do_update(index_elements=table.primary_key, set_=values, where=only)
    return connection.execute(statement, execution_options={"preserve_rowcount": True}).rowcount > 0


def _sqlite_code(error: SQLAlchemyError) -> int:
    return int(getattr(getattr(error, "orig", None), "sqlite_errorcode", 0) & _PRIMARY_CODE)


def _damaged() -> DatabaseError:
    return DatabaseError("the database is damaged", hint=_DAMAGE_HINT)


def _tune_sqlite(connection: Any, record: Any) -> None:
    connection.isolation_level = None  # `_begin_sqlite` sends BEGIN
    more = ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", "secure_delete=ON")
    for pragma in (f"busy_timeout={_BUSY_MS}", *more):
        connection.execute(f"PRAGMA {pragma}")


def _tune_postgres(connection: Any, record: Any) -> None:
    with connection.cursor() as cursor:
        cursor.execute(f"SET idle_in_transaction_session_timeout = {int(IDLE_TRANSACTION_TIMEOUT_S * 1000)}")
    connection.commit()


def _begin_sqlite(connection: Connection) -> None:
    read_only = connection.get_execution_options().get("read_only", False)
    connection.exec_driver_sql("BEGIN" if read_only else "BEGIN IMMEDIATE")


def _open_tables(engine: Engine, save: Save | None) -> None:
    # A server that is just starting refuses a few times.
    for remaining in reversed(range(5)):
        try:
            migrate(engine, save=save)
            return
        except ValueError as error:  # undecodable text, or an unknown revision
            raise DatabaseError(f"the database is damaged: {error}", hint=_DAMAGE_HINT) from error
        except DBAPIError as error:
            if _sqlite_code(error) in _DAMAGE:
                raise _damaged() from error
            if not remaining:
                raise DatabaseError(f"the database does not answer ({type(error.orig).__name__})") from error
            time.sleep(0.2)
