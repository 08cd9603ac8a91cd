"""Resumable uploads: files that grow by acknowledged pieces, sent to any server.

A row counts the durable bytes. They lie in the data folder's file, which one sender at a time has open, or as objects
in a store. Of two senders whose servers share only a store, the one whose bytes are durable first goes on.
"""

from __future__ import annotations

import copy
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from io import FileIO
from pathlib import Path

from fastsplat.service.application.admin.quotas import Quotas
from fastsplat.service.application.uploading.upload_piece import Algorithm, Piece
from fastsplat.service.application.uploading.uploads import disk_error, too_large
from fastsplat.service.common.file_names import safe_parts
from fastsplat.service.store.blobs.reserve import check_free_space
from fastsplat.service.store.repositories.upload_repository import UploadRecord
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import (
    ConflictError,
    FastSplatError,
    InvalidInputError,
    LimitExceededError,
    NotFoundError,
    OffsetConflictError,
)


class ResumableUploads:
    """All unfinished uploads of one database. Safe across threads, processes and servers."""

    _key = ""
    _max_files = 0
    _begin: Callable[[str], object] = staticmethod(lambda key: None)

    def __init__(
        self,
        store: Store,
        max_bytes: int,
        lifetime_s: float,
        quotas: Quotas | None = None,
        min_free_bytes: int = 0,
        wall: Callable[[], float] = time.time,
    ) -> None:
        self._blobs, self._rows = store.blobs, store.uploads
        self._min_free_bytes = min_free_bytes
        self._wall, self._now = wall, store.blobs.clock(wall)
        self._quotas = quotas
        self.max_bytes = max_bytes
        self._lifetime_s = lifetime_s

    def of_key(self, key_id: str, max_files: int, begin: Callable[[str], object]) -> ResumableUploads:
        """Uploads of one upload key, at most `max_files`, hiding all others.

        Together they have at most `max_bytes`, and at most one is incomplete; `begin` may refuse the key in `create`.
        """
        clone = copy.copy(self)
        clone._key, clone._max_files, clone._begin = key_id, max_files, begin
        return clone

    def create(self, project: str, name: str, length: int, metadata: str = "") -> UploadRecord:
        """Announces a file of `length` bytes; durable on return.

        Raises:
            InvalidInputError: an unsafe name, or a negative length.
            LimitExceededError: longer than `max_bytes`, or more or longer files than the key may announce.
            ConflictError: another file of the key is incomplete.
            QuotaError: the project is full.
            ResourceError: too little disk space.
        """
        self._begin(self._key)
        safe_parts(name)
        if length < 0:
            raise InvalidInputError(f"a length of {length} bytes", field="Upload-Length")
        if length > self.max_bytes:
            raise too_large(f"announces {length}", "Upload-Length", self.max_bytes)
        if self._quotas is not None and self._quotas.bounded:
            announced = sum(upload.length for upload in self._rows.of(project, self._now()))
            self._quotas.check_room(project, announced + length)
        check_free_space(self._blobs.root, self._min_free_bytes, length)
        record = UploadRecord(uuid.uuid4().hex, project, self._key, name, length, metadata, self._expiry())
        try:
            self._blobs.begin_data(record.id)
        except OSError as error:
            self._blobs.drop_upload(record.id)
            raise disk_error(error, "upload") from error
        try:
            self._rows.add(record)
            if self._key:  # checked last, so that concurrent announcements see each other
                self._check_owned(project, record.id)
        except BaseException:
            with suppress(FastSplatError):  # what stays expires
                self._drop(record.id)
            raise
        return self._by_wall(record)

    def get(self, project: str, upload_id: str) -> UploadRecord:
        """State of an upload; raises `NotFoundError` if unknown, of another project, or expired."""
        return self._by_wall(self._find(project, upload_id))

    def begin_piece(
        self, project: str, upload_id: str, offset: int, checksum: tuple[Algorithm, bytes] | None = None
    ) -> Piece:
        """Begins bytes at `offset`, in a data folder locking the upload until the piece's `close`.

        Raises:
            NotFoundError: as `get`.
            OffsetConflictError: `offset` is not the upload's end.
            UploadLockedError: another piece is being written.
        """
        self._find(project, upload_id)
        data = self._blobs.open_data(upload_id, offset)
        try:
            record = self._find(project, upload_id)  # again, as the sender before may have had the lock
            if offset != record.offset:
                raise _elsewhere(offset, record.offset)
            check_space = partial(check_free_space, self._blobs.root, self._min_free_bytes)
            return Piece(data, offset, record.length, checksum, self._keeping(record), check_space)
        except BaseException:
            data.close()
            raise

    def delete(self, project: str, upload_id: str) -> None:
        """Removes an upload; raises `NotFoundError` and `UploadLockedError` as `begin_piece`."""
        with self._blobs.open_data(self._find(project, upload_id).id, 0):
            self._drop(upload_id)

    def complete(self, project: str, upload_id: str) -> tuple[str, Path | Iterator[bytes]]:
        """Name, and path or bytes, of a complete, now immutable upload; `OffsetConflictError` if incomplete."""
        record = self._find(project, upload_id)
        if record.offset != record.length:
            raise OffsetConflictError(
                f"upload {upload_id} has {record.offset} of {record.length} bytes",
                field="uploads",
                hint="Send the rest first.",
            )
        return record.name, self._blobs.read_data(upload_id, record.pieces)

    def _keeping(self, record: UploadRecord) -> Callable[[FileIO, int, int], None]:
        """Function that makes the next bytes durable, and counts them."""

        def keep(data: FileIO, begin: int, end: int) -> None:
            nonlocal record
            pieces = [*record.pieces, *self._blobs.keep_data(record.id, data, begin, end)]
            after = replace(record, offset=end, pieces=pieces, expires_at=self._expiry())
            if not self._rows.advance(record, after):
                raise _elsewhere(begin, self._find(record.project, record.id).offset)
            record = after

        return keep

    def _check_owned(self, project: str, new_id: str) -> None:
        """Checks an upload key's limits, the new file included."""
        uploads = [upload for upload in self._rows.of(project, self._now()) if upload.key_id == self._key]
        limits = (
            (sum(upload.length for upload in uploads), self.max_bytes, "bytes (FASTSPLAT_CAPTURE__MAX_UPLOAD_BYTES)"),
            (len(uploads), self._max_files, "files"),
        )
        for count, limit, unit in limits:
            if count > limit:
                raise LimitExceededError(
                    f"the files of this key's upload would be {count} {unit.split()[0]}",
                    field="Upload-Length",
                    limit=f"{limit} {unit}",
                    hint="Send fewer or smaller images, or delete files that were sent and are not needed.",
                )
        for upload in uploads:
            if upload.id != new_id and upload.offset < upload.length:
                raise ConflictError(
                    f"{upload.name!r} of this key's upload is not whole yet",
                    field="upload",
                    hint=f"Send the rest of /v1/uploads/{upload.id} first, or delete it.",
                )

    def _find(self, project: str, upload_id: str) -> UploadRecord:
        record = self._rows.find(upload_id)
        visible = record is not None and record.project == project and self._key in ("", record.key_id)
        if record is None or not visible or record.expires_at <= self._now():
            hint = "It was finished, removed or has expired: start anew."
            raise NotFoundError(f"no upload {upload_id[:80]!r}", field="upload", hint=hint)
        return record

    def _by_wall(self, record: UploadRecord) -> UploadRecord:
        """A record whose expiry is by the wall clock, for the sender."""
        return replace(record, expires_at=self._wall() + record.expires_at - self._now())

    def _expiry(self) -> float:
        return self._now() + self._lifetime_s

    def _drop(self, upload_id: str) -> None:
        self._blobs.drop_upload(upload_id)
        self._rows.remove(upload_id)


def _elsewhere(offset: int, end: int) -> OffsetConflictError:
    return OffsetConflictError(
        f"the piece begins at {offset}, the upload ends at {end}",
        field="Upload-Offset",
        hint="Ask for the offset with HEAD, then go on from there.",
    )
