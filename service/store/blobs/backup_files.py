"""Files of a backup, as `service.store.care.backup` describes them."""

from __future__ import annotations

import json
import sqlite3
import time
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path

from fastsplat.service.common.files import atomic_file, file_sha256
from fastsplat.service.store.blobs.blobs import remove

MANIFEST = "backup.json"
FORMAT = 1


@dataclass(frozen=True)
class BackupReport:
    """The contents of a backup; `bytes` counts all its files."""

    scenes: int
    versions: int
    uploads: int
    bytes: int
    missing: tuple[str, ...]  # folders of the database that do not exist, e.g. "scenes/a/b": damage


@dataclass(frozen=True)
class Entry:
    """A file of a backup: its size in bytes and hexadecimal SHA-256."""

    size: int
    sha256: str


def write_manifest(folder: Path, database: str, report: BackupReport) -> None:
    """Makes a folder with complete files a backup; `database` is sqlite or postgresql."""
    entries = {
        path.relative_to(folder).as_posix(): asdict(Entry(path.stat().st_size, file_sha256(path)))
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


def copy_sqlite(source: Path, target: Path) -> None:
    """Copies a snapshot of a database in use (https://www.sqlite.org/backup.html)."""
    remove(target)
    with closing(sqlite3.connect(source, timeout=30)) as live, closing(sqlite3.connect(target)) as copy:
        live.backup(copy)
        copy.execute("PRAGMA journal_mode=DELETE")  # one file, without a log beside it
    target.chmod(0o600)
