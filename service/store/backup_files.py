"""The files of a backup, whoever makes it: what `service.store.backup` says of them."""

from __future__ import annotations

import hashlib
import json
import sqlite3
import time
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path

from fastsplat.service.common.atomic import atomic_file
from fastsplat.service.store.blobs import remove

MANIFEST = "backup.json"
FORMAT = 1


@dataclass(frozen=True)
class BackupReport:
    """What a backup holds.

    Attributes:
        scenes, versions, uploads: how many were saved.
        bytes: of all files.
        missing: folders that the database names and that are not there, e.g. "scenes/a/b"; the data folder is damaged.
    """

    scenes: int
    versions: int
    uploads: int
    bytes: int
    missing: tuple[str, ...]


@dataclass(frozen=True)
class Entry:
    """A file of a backup: bytes, and the SHA-256 of its content as hexadecimal digits."""

    size: int
    sha256: str


def write_manifest(folder: Path, database: str, report: BackupReport) -> None:
    """Make a folder a backup: its manifest, of all files that are there.

    Args:
        folder: whose other files are whole, and on the disk.
        database: sqlite or postgresql.
        report: what it holds.
    """
    entries = {
        path.relative_to(folder).as_posix(): asdict(Entry(path.stat().st_size, digest(path)))
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    manifest = {
        "format": FORMAT,
        "created_at": time.time(),
        "database": database,
        "report": asdict(report),
        "entries": entries,
    }
    with atomic_file(folder / MANIFEST) as path:
        path.write_text(json.dumps(manifest, indent=1))


def digest(path: Path) -> str:
    """SHA-256 of a file, as hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def copy_sqlite(source: Path, target: Path) -> None:
    """One moment of a database that others write to (https://www.sqlite.org/backup.html)."""
    remove(target)
    with closing(sqlite3.connect(source, timeout=30)) as live, closing(sqlite3.connect(target)) as copy:
        live.backup(copy)
        copy.execute("PRAGMA journal_mode=DELETE")  # one file, without a log beside it
    target.chmod(0o600)
