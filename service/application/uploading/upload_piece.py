"""Pieces of a resumable upload: made durable, then counted."""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Callable
from io import FileIO
from typing import Literal

from fastsplat.service.application.uploading.uploads import SPACE_CHECK_BYTES, disk_error
from fastsplat_contract.errors import ChecksumMismatchError, FastSplatError, LimitExceededError

Algorithm = Literal["sha1", "sha256"]
ALGORITHMS: tuple[Algorithm, ...] = ("sha1", "sha256")
_DURABLE_BYTES = 1 << 24  # maximum to be sent again after a crash


class Piece:
    """A piece being appended, see `ResumableUploads.begin_piece`. For one thread at a time."""

    def __init__(
        self,
        data: FileIO,
        offset: int,
        length: int,
        checksum: tuple[Algorithm, bytes] | None,
        keep: Callable[[FileIO, int, int], None],
        check_space: Callable[[], None],
    ) -> None:
        self._check_space, self._space_checked_at = check_space, offset
        self._data, self._length, self._checksum, self._keep = data, length, checksum, keep
        self._begin = self._end = self._durable = offset
        self._hash = hashlib.new(checksum[0]) if checksum is not None else None
        self._finished = False

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
        """Makes the complete piece durable.

        Raises:
            ChecksumMismatchError: its bytes are not those that were announced.
            OffsetConflictError: those of another server came first.
            ResourceError: the disk is full.
        """
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
        except (OSError, FastSplatError):
            pass  # not acknowledged
        finally:
            self._data.close()

    def _fits(self, digest: bytes) -> bool:
        return self._checksum is not None and hmac.compare_digest(digest, self._checksum[1])

    def _commit(self) -> None:
        self._keep(self._data, self._durable, self._end)
        self._durable = self._end
