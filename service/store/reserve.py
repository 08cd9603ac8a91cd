"""Disk reserve: a file that holds space free for what must work on a full disk: deleting."""

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
_MARGIN = 4
"""The reserve is made where so many times its size is free."""
_LARGEST_SHARE = 20
"""On a small disk, the floor of free space is one part in so many of it."""


@dataclass(frozen=True)
class Reserve:
    """The reserve of one data folder. SQLite cannot write the row that would free megabytes without some bytes more."""

    root: Path

    def fill(self) -> None:
        """Make the file, if it is not there and the disk has room for it."""
        path = self.root / _NAME
        with suppress(OSError):
            if not path.exists() and shutil.disk_usage(self.root).free > _MARGIN * _BYTES:
                handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
                try:
                    os.posix_fallocate(handle, 0, _BYTES)
                finally:
                    os.close(handle)

    def lend(self, call: Callable[[], T]) -> T:
        """The result of `call`, which frees space; if the database refuses, once more without the reserve.

        Raises:
            DatabaseError: it refuses then too, or there is no reserve.
        """
        try:
            return call()
        except DatabaseError:
            if not self._give_up():
                raise
            return call()

    def _give_up(self) -> bool:
        """Whether there was a reserve."""
        try:
            (self.root / _NAME).unlink()
            return True
        except OSError:
            return False


def floor_of(root: Path, floor_bytes: int) -> int:
    """Bytes that must be free for an upload: as set, but no more than a twentieth of a small disk."""
    return min(floor_bytes, shutil.disk_usage(root).total // _LARGEST_SHARE)


def check_free_space(root: Path, floor_bytes: int, more_bytes: int = 0) -> None:
    """Return if an upload may begin.

    Args:
        root: the data folder.
        floor_bytes: must be free beside the upload; on a small disk a twentieth of it is enough.
        more_bytes: size of the upload, as far as it is known.

    Raises:
        ResourceError: there is too little space.
    """
    floor_bytes = floor_of(root, floor_bytes)
    if floor_bytes and shutil.disk_usage(root).free < floor_bytes + more_bytes:
        raise ResourceError(
            "the server's disk is almost full, and takes no uploads",
            field="upload",
            limit=f"{floor_bytes} bytes free beside the upload (FASTSPLAT_UPLOADS__MIN_FREE_BYTES)",
            hint="Delete scenes that are not needed any more, or free space on the server.",
        )
