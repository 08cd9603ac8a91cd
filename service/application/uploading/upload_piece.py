"""Pieces of a resumable upload: made durable, then counted."""

from __future__ import annotations

import hashlib
import hmac
import os
from collections.abc import Callable
from io import FileIO
from pathlib import Path
from typing import Literal

from fastsplat.service.application.uploading.uploads import SPACE_CHECK_BYTES, disk_error
from fastsplat.service.store.blobs.blobs import RESUMABLE_MARK
from fastsplat_contract.errors import ChecksumMismatchError, LimitExceededError

Algorithm = Literal["sha1", "sha256"]
ALGORITHMS: tuple[Algorithm, ...] = ("sha1", "sha256")
OFFSET = RESUMABLE_MARK
"""File with the number of durable bytes."""
_DURABLE_BYTES = 1 << 24  # maximum to be sent again after a crash


class Piece:
    """A piece being appended, see `ResumableUploads.begin_piece`. For one thread at a time."""

    def __init__(
        self,
        folder: Path,
        data: FileIO,
        offset: int,
        length: int,
        checksum: tuple[Algorithm, bytes] | None,
        now: Callable[[], float],
        check_space: Callable[[], None],
    ) -> None:
        self._check_space, self._space_checked_at = check_space, offset
        self._folder, self._data, self._length, self._checksum, self._now = folder, data, length, checksum, now
        self._begin = self._end = self._durable = offset
        self._hash = hashlib.new(checksum[0]) if checksum is not None else None
        self._finished = False
        data.truncate(offset)
        data.seek(offset)

    def write(self, chunk: bytes) -> None:
        """Writes bytes of the piece.

        Raises:
            LimitExceededError: they exceed the announced length.
            ResourceError: the disk is full, or almost.
        """
        if self._end + len(chunk) > self._length:
            raise LimitExceededError(
                "the piece reaches over the announced end",
                field="Upload-Offset",
                limit=f"{self._length} bytes (Upload-Length)",
                hint="Send as many bytes as were announced.",
            )
        if self._end + len(chunk) - self._space_checked_at >= SPACE_CHECK_BYTES:
            self._space_checked_at = self._end + len(chunk)
            self._check_space()
        try:
            rest = memoryview(chunk)
            while rest:
                written = self._data.write(rest)
                self._end += written
                rest = rest[written:]
            if self._hash is not None:
                self._hash.update(chunk)
            elif self._end - self._durable >= _DURABLE_BYTES:
                self._commit()
        except OSError as error:
            raise disk_error(error, "upload") from error

    def finish(self) -> None:
        """Makes the complete piece durable; raises `ChecksumMismatchError` or `ResourceError`."""
        if self._hash is not None and not self._fits(self._hash.digest()):
            raise ChecksumMismatchError(
                "the piece is not what its checksum says",
                field="Upload-Checksum",
                hint=f"Send it again from {self._begin}.",
            )
        try:
            self._commit()
        except OSError as error:
            raise disk_error(error, "upload") from error
        self._finished = True

    def close(self) -> None:
        """Releases the upload; bytes stay unless a checksum is unverified."""
        if self._data.closed:
            return
        try:
            if not self._finished and self._hash is None:
                self._commit()
        except OSError:
            pass  # not acknowledged
        finally:
            self._data.close()

    def _fits(self, digest: bytes) -> bool:
        return self._checksum is not None and hmac.compare_digest(digest, self._checksum[1])

    def _commit(self) -> None:
        os.fsync(self._data.fileno())
        with (self._folder / OFFSET).open("r+") as file:  # in place: 20 bytes of one sector change atomically
            file.write(digits(self._end))
            file.flush()
            os.fsync(file.fileno())
        mark_activity(self._folder, self._now())
        self._durable = self._end


def mark_activity(folder: Path, now: float) -> None:
    """Sets the start of an upload's age, independent of the wall clock."""
    os.utime(folder / OFFSET, (now, now))


def digits(offset: int) -> str:
    return f"{offset:020d}"
