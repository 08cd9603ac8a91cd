"""Checkup of a data folder: problems, and repairs that need no decision."""

from __future__ import annotations

import os
import shutil
import sqlite3
import stat
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import URL, create_engine, inspect, select
from sqlalchemy.exc import SQLAlchemyError

from fastsplat.service.store.blobs.file_digests import DIGESTS, damaged_files
from fastsplat.service.store.blobs.object_store import ObjectStoreBlobs
from fastsplat.service.store.blobs.reserve import floor_of
from fastsplat.service.store.rows.damaged_rows import is_name
from fastsplat.service.store.rows.database import SQLITE_NAME, resolve_url
from fastsplat.service.store.rows.migrations import revisions
from fastsplat.service.store.rows.schema import metadata, operations, scene_versions, scenes
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import ConflictError, FastSplatError

_LOST = "Restore a database that has it; or, if nobody needs it, remove the folder."
_NON_OWNER_BITS = stat.S_IRWXG | stat.S_IRWXO


@dataclass(frozen=True)
class Problem:
    """A problem of a data folder."""

    place: str  # a folder or file relative to the data folder, or "database"
    message: str
    hint: str = ""
    mendable: bool = False  # by `fastsplat doctor --repair`


def check_database(data_dir: Path, database_url: str) -> tuple[Problem, ...]:
    """Checks for damage and schemas of other releases; call it before `open_store`, which upgrades."""
    url = resolve_url(data_dir, database_url)
    if url.get_backend_name() == "sqlite":
        problems = tuple(_check_sqlite(data_dir, SQLITE_NAME))
        if problems or not (data_dir / SQLITE_NAME).exists():
            return problems
    return tuple(_check_schema(url))


def check_folder(data_dir: Path, floor_bytes: int) -> Iterator[Problem]:
    """Checks permissions and free space of a data folder; uploads need `floor_bytes` free."""
    is_open = data_dir.stat().st_mode & _NON_OWNER_BITS  # otherwise nobody else comes to the files in it
    for path in (data_dir / name for name in ("", "key", SQLITE_NAME) if is_open):
        if path.exists() and path.stat().st_mode & _NON_OWNER_BITS:
            mode = f"{stat.S_IMODE(path.stat().st_mode):o}"
            yield Problem(path.name, f"other users may read it (mode {mode})", "Make it its owner's alone.", True)
    if not os.access(data_dir, os.W_OK):
        yield Problem(
            data_dir.name,
            "it cannot be written: its file system is read-only, or it is another user's",
            "Mount its disk for writing, or mend its owner. What else is wrong can be said then.",
        )
    free, floor_bytes = shutil.disk_usage(data_dir).free, floor_of(data_dir, floor_bytes)
    if free < floor_bytes:
        yield Problem(
            data_dir.name,
            f"{free} bytes are free on its disk, and uploads are refused below {floor_bytes}",
            "Delete scenes, or move the folder to a larger disk.",
        )


def mend_folder(data_dir: Path) -> None:
    """Removes the access of all users but the owner from the data folder."""
    for path in (data_dir, *(data_dir / name for name in ("key", SQLITE_NAME))):
        if path.exists():
            path.chmod(path.stat().st_mode & ~_NON_OWNER_BITS & 0o777)


def check_artefacts(store: Store, damage: Callable[[Path], Iterable[FastSplatError]]) -> Iterator[Problem]:
    """Checks for missing or damaged scene versions, and missing uploads of unfinished jobs.

    `damage` reads all files of a version's folder and returns what is damaged.
    """
    with store.engine.execution_options(read_only=True).begin() as connection:
        current = connection.execute(select(scenes.c.id, scenes.c.version).where(scenes.c.version != "")).all()
        rows = connection.execute(select(scene_versions.c.scene_id, scene_versions.c.version)).all()
        waiting = select(operations.c.id, operations.c.upload_id).where(operations.c.state.in_(("QUEUED", "RUNNING")))
        unfinished = connection.execute(waiting).all()
    ready = {scene_id for scene_id, _ in current}
    versions = {tuple(row) for row in current} | {tuple(row) for row in rows if row[0] in ready}
    versions = {row for row in versions if is_name(row[1])}  # others are damage of a row
    hint = "Restore it from a backup, undo to an earlier version, or delete the scene."
    for scene_id, version in sorted(versions):
        place = f"scenes/{scene_id}/{version}"
        inner = "the current version" if (scene_id, version) in {tuple(row) for row in current} else "an older version"
        try:
            folder = store.blobs.fetch_version(scene_id, version)
            if folder is None:
                yield Problem(place, f"{inner} of the scene is missing", hint)
                continue
            digests = tuple(damaged_files(folder))
            read = {error.field for error in digests} <= {DIGESTS}
            errors: tuple[Exception, ...] = (*digests, *(damage(folder) if read else ()))
        except (FastSplatError, OSError) as error:
            errors = (error,)
        for fault in errors:
            yield Problem(place, f"{inner} of the scene is damaged: {fault}", hint)
    there = set(store.blobs.ids("uploads"))
    for operation_id, upload_id in unfinished:
        if upload_id not in there:
            hint = f"Cancel operation {operation_id}, and post the capture again."
            yield Problem(f"uploads/{upload_id}", f"job {operation_id} needs it, and it is missing", hint)


def check_left_over(
    store: Store, upload_expiry_s: float, failed_upload_since: float, ids_before: Callable[[str], tuple[str, ...]]
) -> Iterator[Problem]:
    """Finds folders that are no longer needed; workers, if any, remove them once a minute.

    Args:
        upload_expiry_s: age in seconds after which an uncommitted upload is not needed.
        failed_upload_since: seconds since 1970; uploads of jobs that failed before are not needed.
        ids_before: folder names of a kind, listed before the rows are read.
    """
    jobs, uploads, folders = ids_before("jobs"), ids_before("uploads"), ids_before("scenes")
    for run_id in sorted(store.jobs.over(jobs)):
        yield Problem(f"jobs/{run_id}", "work of a job that is over", mendable=True)
    lost, unknown = store.jobs.lost_scenes(folders, time.time())
    for scene_id in sorted(lost):
        yield Problem(f"scenes/{scene_id}", "the row of this scene is gone: was it deleted?", _LOST)
    for scene_id in sorted(unknown):
        yield Problem(f"scenes/{scene_id}", "the database knows nothing of this scene: is it the right one?", _LOST)
    for name in store.blobs.trashed_scenes():
        yield Problem(f"trash/scenes/{name}", "a scene that lost its row; erased after seven days here", _LOST)
    used, unknown = store.jobs.unneeded_uploads(uploads, failed_upload_since)
    for upload_id in sorted(used.union(name for name in unknown if store.blobs.upload_age(name) > upload_expiry_s)):
        yield Problem(f"uploads/{upload_id}", "an upload that no job needs", mendable=True)
    if not isinstance(store.blobs, ObjectStoreBlobs):
        for path in store.blobs.half_removed():
            yield Problem(f"trash/{path.name}", "it was being removed when a process ended", mendable=True)


def _check_sqlite(data_dir: Path, name: str) -> Iterator[Problem]:
    path = data_dir / name
    if not path.exists():
        return
    hint = "Stop the service and restore a backup."
    try:
        # On a read-only disk, SQLite opens a database in WAL mode only as immutable.
        mode = "mode=ro" if os.access(data_dir, os.W_OK) else "mode=ro&immutable=1"
        with closing(sqlite3.connect(f"file:{path}?{mode}", uri=True, timeout=30)) as connection:
            answer = [row[0] for row in connection.execute("PRAGMA integrity_check(3)")]
    except sqlite3.DatabaseError as error:
        yield Problem(name, f"the database is damaged or cannot be read: {error}", hint)
        return
    if answer != ["ok"]:
        yield Problem(name, f"the database is damaged: {'; '.join(answer)[:300]}", hint)


def _check_schema(url: URL) -> Iterator[Problem]:
    engine = create_engine(url)
    try:
        with engine.connect() as connection:
            stored, newest = revisions(connection)
            missing = sorted(metadata.tables.keys() - set(inspect(connection).get_table_names()))
    except ValueError as error:
        yield Problem("database", str(error), "Stop the service and restore a backup.")
        return
    except ConflictError as error:
        yield Problem("database", error.message, error.hint)
        return
    except SQLAlchemyError as error:
        yield Problem("database", f"it does not answer ({type(error).__name__})", "Start it, or mend its URL.")
        return
    finally:
        engine.dispose()
    if stored < newest:
        hint = "Make a backup; the next start of the service, or --repair, brings it to this release's."
        yield Problem("database", f"it is of version {stored}, and this release's is {newest}", hint, True)
    elif missing:
        yield Problem("database", f"tables are missing: {', '.join(missing)}", "Stop the service and restore a backup.")
