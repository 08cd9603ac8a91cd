"""Resumable uploads: files that grow by acknowledged pieces until a scene is made of them.

uploads/<id>/resumable.json   what was announced
uploads/<id>/offset           how many bytes are durable: written only after the bytes themselves; when it was changed
                              says how old the upload is, by `ActivityClock`
uploads/<id>/data             the bytes; what lies behind the offset was never acknowledged and is cut off

Any number of processes may serve one folder: who appends holds a lock on `data`, which the kernel takes back from a
process that dies.
"""

from __future__ import annotations

import copy
import fcntl
import json
import os
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from io import FileIO
from pathlib import Path

from fastsplat.service.application.admin.quotas import Quotas
from fastsplat.service.application.uploading.upload_piece import OFFSET, Algorithm, Piece, digits, mark_activity
from fastsplat.service.application.uploading.uploads import disk_error
from fastsplat.service.common.atomic import sync_directory
from fastsplat.service.common.file_names import safe_parts
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
        id: names it.
        name: the file's name in the capture, e.g. "capture.zip" or "images/0001.jpg".
        length: bytes it will have.
        offset: bytes that are durable.
        metadata: what the client said about it, as sent.
        expires_at: seconds since 1970, UTC; every piece moves it.
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
    """Id of the key for one upload that announced it; "" for other keys."""


class ResumableUploads:
    """All unfinished uploads of one data folder. Safe from any thread and from several processes."""

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
        """The uploads of a key for one upload, as if there were no others: files that become one scene together.

        Args:
            key_id: the key's.
            max_files: so many it may announce; together they have at most `max_bytes`, and one at a time is not whole.
        """
        own = copy.copy(self)
        own._key, own._max_files = key_id, max_files
        return own

    def create(self, project: str, name: str, length: int, metadata: str = "") -> Resumable:
        """Announce a file; durable on return.

        Args:
            project: whose keys may go on with it.
            name: see `Resumable`.
            length: bytes it will have.
            metadata: kept as it is.

        Raises:
            InvalidInputError: an unsafe name, or a negative length.
            LimitExceededError: longer than `max_bytes`, or more or longer files than the key may announce.
            ConflictError: another file of the key is not whole yet.
            QuotaError: the project holds all that it may.
            ResourceError: the disk is full, or has too little space for it.
        """
        safe_parts(name)
        if length < 0:
            raise InvalidInputError(f"a length of {length} bytes", field="Upload-Length")
        if length > self.max_bytes:
            raise LimitExceededError(
                f"the upload announces {length} bytes",
                field="Upload-Length",
                limit=f"{self.max_bytes} bytes (FASTSPLAT_CAPTURE__MAX_UPLOAD_BYTES)",
                hint="Send fewer or smaller images.",
            )
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
            if self._key:  # only now, so that of two at the same moment each sees the other
                self._check_owned(project, upload_id)
        except BaseException:
            remove(folder)
            raise
        return self.get(project, upload_id)

    def get(self, project: str, upload_id: str) -> Resumable:
        """Where an upload stands.

        Raises:
            NotFoundError: there is none of that id, not of this project, or it has expired.
        """
        folder, info = self._find(project, upload_id)
        offset = int((folder / OFFSET).read_text())
        expires_at = self._wall() + self._lifetime_s - self._age(folder)
        return Resumable(upload_id, info.name, info.length, offset, info.metadata, expires_at)

    def append(
        self,
        project: str,
        upload_id: str,
        offset: int,
        chunks: Iterable[bytes],
        checksum: tuple[Algorithm, bytes] | None = None,
    ) -> Resumable:
        """Take the bytes from `offset` on; what is acknowledged is on disk. Returns the upload as it then stands.

        If `chunks` raises, what came before stays and can be built upon, unless a checksum was to be met.

        Raises:
            NotFoundError: as `get`.
            OffsetConflictError: `offset` is not where the upload ends.
            UploadLockedError: another piece is coming in.
            ChecksumMismatchError: the piece is not what its checksum says.
            LimitExceededError: more bytes than announced; those announced stay.
            ResourceError: the disk is full.
        """
        piece = self.begin_piece(project, upload_id, offset, checksum)
        try:
            for chunk in chunks:
                piece.write(chunk)
            piece.finish()
        except OSError as error:
            raise disk_error(error, "upload") from error
        finally:
            piece.close()
        return self.get(project, upload_id)

    def begin_piece(
        self, project: str, upload_id: str, offset: int, checksum: tuple[Algorithm, bytes] | None = None
    ) -> Piece:
        """The same, to be written step by step; until its `close`, no other piece of this upload comes in.

        Raises:
            NotFoundError, OffsetConflictError, UploadLockedError: as `append`.
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
        """Forget an upload.

        Raises:
            NotFoundError, UploadLockedError: as `append`.
        """
        folder, _ = self._find(project, upload_id)
        with closing(_locked(folder)):
            remove(folder)

    def complete(self, project: str, upload_id: str) -> tuple[str, Path]:
        """Name and bytes of an upload that is whole; it will never change again.

        Raises:
            NotFoundError: as `get`.
            OffsetConflictError: it is not whole.
        """
        upload = self.get(project, upload_id)
        if upload.offset != upload.length:
            raise OffsetConflictError(
                f"upload {upload_id} has {upload.offset} of {upload.length} bytes",
                field="uploads",
                hint="Send the rest first.",
            )
        return upload.name, self._blobs.upload(upload_id) / _DATA

    def _check_owned(self, project: str, new_id: str) -> None:
        """Raise if a key for one upload may not have what it has, the new file included."""
        owned = list(self._all(project))
        limits = (
            (sum(upload.length for upload in owned), self.max_bytes, "bytes (FASTSPLAT_CAPTURE__MAX_UPLOAD_BYTES)"),
            (len(owned), self._max_files, "files"),
        )
        for count, limit, unit in limits:
            if count > limit:
                raise LimitExceededError(
                    f"the files of this key's upload would be {count} {unit.split()[0]}",
                    field="Upload-Length",
                    limit=f"{limit} {unit}",
                    hint="Send fewer or smaller images, or delete files that were sent and are not needed.",
                )
        for upload in owned:
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
            except (NotFoundError, OSError, ValueError):  # of others, or removed meanwhile
                continue

    def _age(self, folder: Path) -> float:
        """Seconds since the last piece."""
        return self._clock.now() - (folder / OFFSET).stat().st_mtime

    def _find(self, project: str, upload_id: str) -> tuple[Path, _Info]:
        try:
            folder = self._blobs.upload(upload_id)
            info = _Info(**json.loads((folder / _INFO).read_text()))
            owned = info.project == project and self._key in ("", info.key)
            if owned and self._age(folder) < self._lifetime_s:
                return folder, info
        except (OSError, ValueError):
            pass
        raise NotFoundError(
            f"no upload {upload_id[:80]!r}", field="upload", hint="It was finished, removed or has expired: start anew."
        )


def _locked(folder: Path) -> FileIO:
    """The open `data`, locked until it is closed."""
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
