"""Disk reserve: a file that keeps space for deletions on a full disk."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from fastsplat_contract.errors import DatabaseError, ResourceError

T = TypeVar("T")
_NAME = ".reserve"
_BYTES = 8 << 20
_MARGIN = 4  # the reserve is made only if this many times its size is free
_LARGEST_SHARE = 20  # on a small disk, the floor of free space is its size divided by this


@dataclass(frozen=True)
class Reserve:
    """The reserve of a data folder; SQLite needs some space even to delete rows."""

    root: Path

    def fill(self) -> None:
        """Makes the file, if it is missing and the disk has room for it."""
        path = self.root / _NAME
        with suppress(OSError):
            if not path.exists() and shutil.disk_usage(self.root).free > _MARGIN * _BYTES:
                handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
                try:
                    os.posix_fallocate(handle, 0, _BYTES)
                finally:
                    os.close(handle)

    def lend(self, call: Callable[[], T]) -> T:
        """Calls `call`, which frees space; after a `DatabaseError` once more, without the reserve."""
        try:
            return call()
        except DatabaseError:
            if not self._give_up():
                raise
            return call()

    def _give_up(self) -> bool:
        """Removes the reserve; True if there was one."""
        try:
            (self.root / _NAME).unlink()
            return True
        except OSError:
            return False


def floor_of(root: Path, floor_bytes: int) -> int:
    """Returns the bytes that uploads leave free, at most a twentieth of the disk."""
    return min(floor_bytes, shutil.disk_usage(root).total // _LARGEST_SHARE)


def check_free_space(root: Path, floor_bytes: int, more_bytes: int = 0) -> None:
    """Raises `ResourceError` unless an upload of `more_bytes` leaves the floor (`floor_of`) free."""
    floor_bytes = floor_of(root, floor_bytes)
    if floor_bytes and shutil.disk_usage(root).free < floor_bytes + more_bytes:
        raise ResourceError(
            "the server's disk is almost full, and takes no uploads",
            field="upload",
            limit=f"{floor_bytes} bytes free beside the upload (FASTSPLAT_UPLOADS__MIN_FREE_BYTES)",
            hint="Delete scenes that are not needed any more, or free space on the server.",
        )
