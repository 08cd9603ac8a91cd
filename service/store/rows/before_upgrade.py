"""Backup of an earlier release's rows before this release changes its tables.

`fastsplat restore` of either release takes it. It holds rows only: scene versions and uploads never change and stay in
the data folder. The next upgrade replaces it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from sqlalchemy import (
    JSON,
    URL,
    Connection,
    MetaData,
    Text,
    cast,
    column,
    create_engine,
    insert,
    inspect,
    select,
    table,
)

from fastsplat.service.common.files import atomic_directory, sync_tree
from fastsplat.service.store.blobs.backup_files import BackupReport, copy_sqlite, write_manifest
from fastsplat.service.store.rows.database import SQLITE_NAME
from fastsplat_contract.errors import ResourceError

FOLDER = "before-upgrade"
"""Name of the backup's folder in the data folder."""
_ROWS = 200
_log = logging.getLogger(__name__)


def save_before_upgrade(data_dir: Path, live: Connection, bring: Callable[[Connection], None]) -> None:
    """Saves a database that is about to be upgraded.

    Args:
        live: connection in the upgrading transaction, whose lock keeps others from writing (SQLite) or upgrading
            (PostgreSQL).
        bring: makes the tables of `live` in an empty database.

    Raises:
        ResourceError: the disk is full or cannot be written; the database is unchanged.
    """
    target = data_dir / FOLDER
    try:
        with atomic_directory(target) as folder:
            folder.chmod(0o700)
            file = folder / SQLITE_NAME
            if live.dialect.name == "sqlite":
                copy_sqlite(Path(str(live.engine.url.database)), file)
            else:
                _copy_rows(live, file, bring)
                file.chmod(0o600)
            sync_tree(folder)
            write_manifest(folder, live.dialect.name, BackupReport(0, 0, 0, file.stat().st_size, ()))
    except OSError as error:
        raise ResourceError(
            f"the database cannot be saved before it is upgraded: {error.strerror}",
            field="data_dir",
            hint="Free space, or mend the folder's owner. Nothing was changed.",
        ) from error
    _log.warning("the database is upgraded; what it held is saved in %s", target)


def _copy_rows(live: Connection, file: Path, bring: Callable[[Connection], None]) -> None:
    """Copies rows without the schema of this release, in which columns may have other names."""
    known = inspect(live)
    tables = MetaData()
    tables.reflect(live)
    engine = create_engine(URL.create("sqlite", database=str(file)))
    try:
        with engine.begin() as copy:
            bring(copy)
            for name in inspect(copy).get_table_names():
                if not known.has_table(name) or name == "alembic_version":
                    continue
                source = tables.tables[name]
                copy.exec_driver_sql(f"DELETE FROM {name}")
                plain = table(name, *(column(col.name) for col in source.columns))
                # JSON as text, as SQL NULL would otherwise become the JSON value "null".
                columns = [cast(col, Text).label(col.name) if isinstance(col.type, JSON) else col for col in source.c]
                for rows in live.execute(select(*columns)).mappings().partitions(_ROWS):
                    copy.execute(insert(plain), [dict(row) for row in rows])
    finally:
        engine.dispose()
