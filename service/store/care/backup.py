"""Backups of a data folder while the service runs, and their restoration.

A backup is a folder:

    backup.json           contents with sizes and digests; written last: a folder without it is no backup
    fastsplat.sqlite      the database (SQLite's backup API); for PostgreSQL a snapshot of its rows in the same tables,
                          without the need for any PostgreSQL program
    files/                scene versions and uploads of unfinished jobs, as in the data folder: hard links (they never
                          change) on the same disk, copies elsewhere
    files/key             the first key

Rows are saved before files, so a file that a row names is there or was deleted meanwhile; then both are saved again.
Not saved: stage results of running jobs (they start over), uploads that are incomplete or of failed jobs, and logs.
With an object store, scenes and uploads stay there, to be backed up by its own versioning.
"""

from __future__ import annotations

import json
import shutil
import sqlite3
import tempfile
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path, PurePosixPath
from typing import Any

from sqlalchemy import URL, Connection, create_engine, delete, insert, select, update

from fastsplat.service.common.files import atomic_file, file_sha256, link_or_copy, sync_directory, sync_tree
from fastsplat.service.store.blobs.backup_files import (
    FORMAT,
    MANIFEST,
    BackupReport,
    Entry,
    copy_sqlite,
    write_manifest,
)
from fastsplat.service.store.blobs.blobs import remove
from fastsplat.service.store.blobs.object_store import ObjectStoreBlobs
from fastsplat.service.store.rows.database import SQLITE_NAME, open_engine, resolve_url, transaction
from fastsplat.service.store.rows.schema import api_keys, metadata, operations, scene_versions, scenes, workers
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import ConflictError, InvalidInputError, NotFoundError, ResourceError

_SQLITE, _FILES, _KEY = SQLITE_NAME, "files", "key"
_TRIES = 5
_ROWS = 200
_UNFINISHED = ("QUEUED", "RUNNING")


def back_up(store: Store, data_dir: Path, database_url: str, target: Path) -> BackupReport:
    """Saves all durable state of a data folder, possibly in use, to a new one.

    Raises:
        ConflictError: `target` is there already.
        ResourceError: the disk is full.
        DatabaseError: the database does not answer.
    """
    if target.exists():
        raise ConflictError(f"{target} is there already", field="target", hint="Name a folder that does not exist yet.")
    partial = target.with_name(f".{target.name}.partial")
    remove(partial)
    try:
        partial.mkdir(mode=0o700, parents=True)
        (partial / _FILES).mkdir(mode=0o700)
        report = _save(store, data_dir, database_url, partial)
        partial.rename(target)
        sync_directory(target.parent)
    except OSError as error:
        raise ResourceError(
            f"the backup cannot be written: {error.strerror}", field="target", hint="Free space, or name another disk."
        ) from error
    finally:
        remove(partial)
    return report


def restore(backup: Path, data_dir: Path, database_url: str) -> BackupReport:
    """Restores a data folder and its database, which no service may use.

    Running jobs begin again; waiting ones still wait.

    Raises:
        NotFoundError: there is no backup.
        InvalidInputError: it is damaged, or of the other kind of database.
        ConflictError: the data folder is not empty, or the PostgreSQL database has scenes, jobs or keys.
        ResourceError: the disk is full.
    """
    manifest = _read_manifest(backup)
    url = resolve_url(data_dir, database_url)
    kind = url.get_backend_name()
    if manifest["database"] != kind:
        raise InvalidInputError(
            f"the backup is of {manifest['database']}, and the settings name {kind}",
            field="database_url",
            hint="Set FASTSPLAT_DATABASE_URL to a database of that kind, or unset it for SQLite.",
        )
    if data_dir.is_dir() and any(data_dir.iterdir()):
        raise ConflictError(
            f"{data_dir} is not empty", field="data_dir", hint="Restore into a new folder, then move it into place."
        )
    entries = {name: Entry(**entry) for name, entry in manifest["entries"].items()}
    _check_entries(backup, entries)
    try:
        data_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
        for name in entries:
            parts = PurePosixPath(name).parts
            if parts[0] == _FILES:
                target = data_dir.joinpath(*parts[1:])
                target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                shutil.copyfile(backup / name, target)
                target.chmod(0o600)
        sync_tree(data_dir)
        if kind == "sqlite":
            with atomic_file(data_dir / _SQLITE) as path:
                shutil.copyfile(backup / _SQLITE, path)
                path.chmod(0o600)
        else:
            _copy_rows_in(backup / _SQLITE, url)
        _queue_again(url)
    except OSError as error:
        raise ResourceError(
            f"the backup cannot be restored: {error.strerror}",
            field="data_dir",
            hint="Remove what is in the data folder, free space, and restore again.",
        ) from error
    return BackupReport(**{**manifest["report"], "missing": tuple(manifest["report"]["missing"])})


def _save(store: Store, data_dir: Path, database_url: str, target: Path) -> BackupReport:
    url = resolve_url(data_dir, database_url)
    for _ in range(_TRIES):
        if url.get_backend_name() == "sqlite":
            copy_sqlite(Path(str(url.database)), target / _SQLITE)
        else:
            _copy_rows_out(url, target / _SQLITE)
        versions, uploads = _named_by(URL.create("sqlite", database=str(target / _SQLITE)))
        folders = [*(f"scenes/{version}" for version in versions), *(f"uploads/{upload}" for upload in uploads)]
        if isinstance(store.blobs, ObjectStoreBlobs):
            folders = []
        missing = tuple(name for name in folders if not _save_folder(data_dir / name, target / _FILES / name))
        if not missing:
            break
    if (data_dir / _KEY).is_file():
        shutil.copyfile(data_dir / _KEY, target / _FILES / _KEY)
        (target / _FILES / _KEY).chmod(0o600)
    report = BackupReport(
        scenes=len({version.partition("/")[0] for version in versions}),
        versions=len(versions),
        uploads=len(uploads),
        bytes=sum(path.stat().st_size for path in target.rglob("*") if path.is_file()),
        missing=missing,
    )
    sync_tree(target)
    write_manifest(target, url.get_backend_name(), report)
    return report


def _copy_rows_out(source: URL, target: Path) -> None:
    """Copies a snapshot of a PostgreSQL database in use to a new SQLite database."""
    remove(target)
    live = create_engine(source)
    copy = open_engine(URL.create("sqlite", database=str(target)))
    try:
        # A REPEATABLE READ transaction reads from one snapshot (PostgreSQL 17, section 13.2.2).
        snapshot = live.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
        with transaction(snapshot) as reading, transaction(copy) as writing:
            _copy_rows(reading, writing)
    finally:
        copy.dispose()
        live.dispose()
    with closing(sqlite3.connect(target)) as connection:
        connection.execute("PRAGMA journal_mode=DELETE")  # one file, without a log beside it
    target.chmod(0o600)


def _copy_rows_in(source: Path, target: URL) -> None:
    """Fills a PostgreSQL database from a backup of any release; `ConflictError` unless it is empty."""
    live = open_engine(target)
    with tempfile.TemporaryDirectory(prefix="fastsplat-restore-") as folder:
        database = Path(folder) / _SQLITE
        shutil.copyfile(source, database)
        saved = open_engine(URL.create("sqlite", database=str(database)))  # brings an older schema to this release's
        try:
            with transaction(saved.execution_options(read_only=True)) as reading, transaction(live) as writing:
                if any(writing.execute(select(table).limit(1)).first() for table in (scenes, operations, api_keys)):
                    raise ConflictError(
                        "the database is not empty", field="database_url", hint="Restore into a new database."
                    )
                _copy_rows(reading, writing)
        finally:
            saved.dispose()
            live.dispose()


def _copy_rows(source: Connection, target: Connection) -> None:
    """Replaces all rows of `target` by those of `source`."""
    for table in reversed(metadata.sorted_tables):
        target.execute(delete(table))
    for table in metadata.sorted_tables:
        rows = source.execution_options(yield_per=_ROWS).execute(select(table)).mappings()
        for some in rows.partitions():
            target.execute(insert(table), [{column.key: row[column] for column in table.columns} for row in some])


def _named_by(url: URL) -> tuple[list[str], list[str]]:
    """Lists "<scene id>/<version>" of all versions, and the upload ids of unfinished jobs."""
    engine = create_engine(url)
    try:
        with engine.connect() as connection:
            current = connection.execute(select(scenes.c.id, scenes.c.version).where(scenes.c.version != "")).all()
            ready = {scene_id for scene_id, _ in current}
            rows = connection.execute(select(scene_versions.c.scene_id, scene_versions.c.version)).all()
            versions = {*map(tuple, current), *(tuple(row) for row in rows if row[0] in ready)}
            needed = select(operations.c.upload_id).where(operations.c.state.in_(_UNFINISHED))
            uploads = sorted(set(connection.scalars(needed)))
    finally:
        engine.dispose()
    return sorted(f"{scene_id}/{version}" for scene_id, version in versions), uploads


def _save_folder(source: Path, target: Path) -> bool:
    """Links or copies a folder that never changes; False if it is missing or disappears."""
    if target.is_dir():
        return True
    partial = target.with_name(f".{target.name}.partial")
    remove(partial)
    partial.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    try:
        shutil.copytree(source, partial, copy_function=link_or_copy)
    except (FileNotFoundError, shutil.Error):
        remove(partial)
        if source.is_dir():
            raise
        return False
    if not source.is_dir():  # it was being removed, file by file
        remove(partial)
        return False
    partial.rename(target)
    return True


def _read_manifest(backup: Path) -> dict[str, Any]:
    try:
        manifest: dict[str, Any] = json.loads((backup / MANIFEST).read_text())
    except FileNotFoundError as error:
        raise NotFoundError(f"{backup} is no backup", field="backup", hint=f"It has no {MANIFEST}.") from error
    except ValueError as error:
        raise _damaged(MANIFEST) from error
    if manifest.get("format") != FORMAT:
        raise InvalidInputError(f"the backup is of format {manifest.get('format')}", field="backup", limit=str(FORMAT))
    return manifest


def _check_entries(backup: Path, entries: Mapping[str, Entry]) -> None:
    for name, entry in entries.items():
        path = backup.joinpath(*PurePosixPath(name).parts)
        if ".." in PurePosixPath(name).parts or not path.is_file() or path.stat().st_size != entry.size:
            raise _damaged(name)
        if file_sha256(path) != entry.sha256:
            raise _damaged(name)


def _damaged(name: str) -> InvalidInputError:
    return InvalidInputError(
        f"{name} of the backup is damaged or missing", field=name[:200], hint="Restore another backup."
    )


def _queue_again(url: URL) -> None:
    engine = open_engine(url)
    try:
        with engine.begin() as connection:
            waiting = update(operations).where(operations.c.state.in_(_UNFINISHED))
            connection.execute(waiting.values(state="QUEUED", worker="", starts=0))
            connection.execute(delete(workers))
    finally:
        engine.dispose()
