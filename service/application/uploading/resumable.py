"""Resumable uploads: files that grow by acknowledged pieces.

uploads/<id>/resumable.json   announcement
uploads/<id>/offset           durable bytes, written after the bytes themselves; its mtime is the upload's age
                              by `ActivityClock`
uploads/<id>/data             the bytes; those behind the offset were never acknowledged and are cut off

Processes may share a folder: appending holds a lock on `data`, which the kernel releases if the process dies.
"""

from __future__ import annotations

import copy
import fcntl
import json
import os
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from io import FileIO
from pathlib import Path

from fastsplat.service.application.admin.quotas import Quotas
from fastsplat.service.application.uploading.upload_piece import OFFSET, Algorithm, Piece, digits, mark_activity
from fastsplat.service.application.uploading.uploads import disk_error, too_large
from fastsplat.service.common.file_names import safe_parts
from fastsplat.service.common.files import sync_directory
from fastsplat.service.store.blobs.activity_clock import ActivityClock
from fastsplat.service.store.blobs.blobs import Blobs, remove
from fastsplat.service.store.blobs.reserve import check_free_space
from fastsplat_contract.errors import (
    ConflictError,
    InvalidInputError,
    LimitExceededError,
    NotFoundError,
    OffsetConflictError,
    UploadLockedError,
)

_INFO, _DATA = "resumable.json", "data"


@dataclass(frozen=True)
class Resumable:
    """One upload.

    Attributes:
        name: of the file in the capture, e.g. "capture.zip" or "images/0001.jpg".
        length: announced bytes.
        offset: durable bytes.
        metadata: as sent by the client.
        expires_at: seconds since 1970, UTC; extended by every piece.
    """

    id: str
    name: str
    length: int
    offset: int
    metadata: str
    expires_at: float


@dataclass(frozen=True)
class _Info:
    project: str
    name: str
    length: int
    metadata: str
    key: str = ""
    """Id of the upload key that announced it; "" for other keys."""


class ResumableUploads:
    """All unfinished uploads of one data folder. Safe across threads and processes."""

    _key = ""
    _max_files = 0

    def __init__(
        self,
        blobs: Blobs,
        max_bytes: int,
        lifetime_s: float,
        quotas: Quotas | None = None,
        min_free_bytes: int = 0,
        wall: Callable[[], float] = time.time,
    ) -> None:
        self._min_free_bytes = min_free_bytes
        self._blobs = blobs
        self._wall = wall
        self._clock = ActivityClock(blobs.root, wall)
        self._quotas = quotas
        self.max_bytes = max_bytes
        self._lifetime_s = lifetime_s

    def of_key(self, key_id: str, max_files: int) -> ResumableUploads:
        """Uploads of one upload key, at most `max_files`, hiding all others.

        Together they have at most `max_bytes`, and at most one is incomplete.
        """
        clone = copy.copy(self)
        clone._key, clone._max_files = key_id, max_files
        return clone

    def create(self, project: str, name: str, length: int, metadata: str = "") -> Resumable:
        """Announces a file of `length` bytes; durable on return.

        Raises:
            InvalidInputError: an unsafe name, or a negative length.
            LimitExceededError: longer than `max_bytes`, or more or longer files than the key may announce.
            ConflictError: another file of the key is incomplete.
            QuotaError: the project is full.
            ResourceError: too little disk space.
        """
        safe_parts(name)
        if length < 0:
            raise InvalidInputError(f"a length of {length} bytes", field="Upload-Length")
        if length > self.max_bytes:
            raise too_large(f"announces {length}", "Upload-Length", self.max_bytes)
        if self._quotas is not None and self._quotas.bounded:
            self._quotas.check_room(project, length + sum(upload.length for upload in self._all(project)))
        check_free_space(self._blobs.root, self._min_free_bytes, length)
        upload_id = uuid.uuid4().hex
        folder = self._blobs.upload(upload_id)
        try:
            folder.mkdir(parents=True)
            _write_durably(folder / _DATA, "")
            _write_durably(folder / OFFSET, digits(0))
            # Last: a folder without it is no upload.
            _write_durably(folder / _INFO, json.dumps(asdict(_Info(project, name, length, metadata, self._key))))
            mark_activity(folder, self._clock.now())
            sync_directory(folder)
            sync_directory(folder.parent)
        except OSError as error:
            remove(folder)
            raise disk_error(error, "upload") from error
        try:
            if self._key:  # checked last, so that concurrent announcements see each other
                self._check_owned(project, upload_id)
        except BaseException:
            remove(folder)
            raise
        return self.get(project, upload_id)

    def get(self, project: str, upload_id: str) -> Resumable:
        """State of an upload; raises `NotFoundError` if unknown, of another project, or expired."""
        folder, info = self._find(project, upload_id)
        offset = int((folder / OFFSET).read_text())
        expires_at = self._wall() + self._lifetime_s - self._age(folder)
        return Resumable(upload_id, info.name, info.length, offset, info.metadata, expires_at)

    def begin_piece(
        self, project: str, upload_id: str, offset: int, checksum: tuple[Algorithm, bytes] | None = None
    ) -> Piece:
        """Begins bytes at `offset`, locking the upload until the piece's `close`.

        Raises:
            NotFoundError: as `get`.
            OffsetConflictError: `offset` is not the upload's end.
            UploadLockedError: another piece is being written.
        """
        folder, info = self._find(project, upload_id)
        data = _locked(folder)
        try:
            reached = int((folder / OFFSET).read_text())
            if offset != reached:
                raise OffsetConflictError(
                    f"the piece begins at {offset}, the upload ends at {reached}",
                    field="Upload-Offset",
                    hint="Ask for the offset with HEAD, then go on from there.",
                )
            mark_activity(folder, self._clock.now())
            check_space = partial(check_free_space, self._blobs.root, self._min_free_bytes)
            return Piece(folder, data, reached, info.length, checksum, self._clock.now, check_space)
        except BaseException:
            data.close()
            raise

    def delete(self, project: str, upload_id: str) -> None:
        """Removes an upload; raises `NotFoundError` and `UploadLockedError` as `begin_piece`."""
        folder, _ = self._find(project, upload_id)
        with closing(_locked(folder)):
            remove(folder)

    def complete(self, project: str, upload_id: str) -> tuple[str, Path]:
        """Name and path of a complete, now immutable upload; `OffsetConflictError` if incomplete."""
        upload = self.get(project, upload_id)
        if upload.offset != upload.length:
            raise OffsetConflictError(
                f"upload {upload_id} has {upload.offset} of {upload.length} bytes",
                field="uploads",
                hint="Send the rest first.",
            )
        return upload.name, self._blobs.upload(upload_id) / _DATA

    def _check_owned(self, project: str, new_id: str) -> None:
        """Checks an upload key's limits, the new file included."""
        uploads = list(self._all(project))
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

    def _all(self, project: str) -> Iterator[Resumable]:
        for upload_id in self._blobs.ids("uploads"):
            try:
                yield self.get(project, upload_id)
            except (NotFoundError, OSError, ValueError):  # another project's, or removed meanwhile
                continue

    def _age(self, folder: Path) -> float:
        """Seconds since the last piece."""
        return self._clock.now() - (folder / OFFSET).stat().st_mtime

    def _find(self, project: str, upload_id: str) -> tuple[Path, _Info]:
        try:
            folder = self._blobs.upload(upload_id)
            info = _Info(**json.loads((folder / _INFO).read_text()))
            visible = info.project == project and self._key in ("", info.key)
            if visible and self._age(folder) < self._lifetime_s:
                return folder, info
        except (OSError, ValueError):
            pass
        raise NotFoundError(
            f"no upload {upload_id[:80]!r}", field="upload", hint="It was finished, removed or has expired: start anew."
        )


def _locked(folder: Path) -> FileIO:
    """Opens `data`, locked until closed."""
    try:
        data = (folder / _DATA).open("r+b", buffering=0)
    except OSError:
        raise NotFoundError(f"no upload {folder.name!r}", field="upload") from None
    try:
        fcntl.flock(data, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        data.close()
        raise UploadLockedError(
            "another piece of this upload is coming in",
            field="upload",
            hint="Wait until it has ended, ask for the offset, then go on.",
        ) from None
    return data


def _write_durably(path: Path, text: str) -> None:
    with path.open("x") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
