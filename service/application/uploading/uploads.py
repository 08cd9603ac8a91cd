"""Upload sessions: bounded, safely named files that become a job or are removed."""

from __future__ import annotations

import errno
import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import asdict
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import Source
from fastsplat.service.common.file_names import safe_parts
from fastsplat.service.common.files import file_sha256
from fastsplat.service.store.blobs.blobs import lock_of, remove
from fastsplat_contract.errors import DatabaseError, InvalidInputError, LimitExceededError, ResourceError
from fastsplat_contract.jobs.operations import SceneOptions

_CHUNK = 1 << 20
SPACE_CHECK_BYTES = 1 << 24
"""Interval of free-space checks, in received bytes."""


class UploadSession(AbstractContextManager["UploadSession"]):
    """Files of one future scene: `raw` inside `folder`. For one thread at a time.

    A context manager: leaving it before `SceneService.create_scene` removes everything. `check_space` raises if too
    little disk space is free.
    """

    def __init__(
        self, upload_id: str, folder: Path, settings: CaptureSettings, check_space: Callable[[], None] = lambda: None
    ) -> None:
        self.id = upload_id
        self.folder = folder
        self.raw = folder / "raw"
        self._settings = settings
        self._check_space = check_space
        self._space_checked_at = 0
        self._digests: dict[str, str] = {}
        self._files_of_name: Counter[str] = Counter()
        self._bytes = 0
        self._open = True
        self._file: UploadFile | None = None
        try:
            self.raw.mkdir(parents=True)
            self._lock = lock_of(folder)  # marks it as in use
        except OSError as error:
            raise disk_error(error, "upload") from error

    def __exit__(self, *exception: object) -> None:
        self.abort()

    def write(self, name: str, stream: BinaryIO | Iterable[bytes]) -> int:
        """Writes one file, keeping folders in its name; returns its size in bytes.

        Args:
            name: relative path with forward slashes, e.g. "images/0001.jpg". A repeated name, as from two memory cards,
                is stored as "images/0001 (2).jpg".
            stream: a binary file, or chunks of bytes.

        Raises:
            InvalidInputError: the name is unsafe or a folder's, or the session is over.
            LimitExceededError: too many bytes or files; call `abort`.
            ResourceError: the disk is full.
        """
        file = self.begin(name)
        try:
            for chunk in _chunks(stream):
                file.write(chunk)
        except OSError as error:
            file.discard()
            raise disk_error(error, name) from error
        except BaseException:
            file.discard()
            raise
        return file.end()

    def begin(self, name: str) -> UploadFile:
        """Opens a file to write in pieces, one at a time; raises as `write`."""
        self._check_open()
        name, path = self._place(name)
        self._file = UploadFile(name, path, self._check_bytes, self._ended)
        return self._file

    def _ended(self, name: str, size: int, digest: str) -> None:
        self._bytes += size
        self._digests[name] = digest

    def adopt(self, name: str, source: Path | Iterator[bytes]) -> int:
        """Hard-links an immutable file of the same disk, or writes bytes; returns their number, raises as `write`."""
        if not isinstance(source, Path):
            return self.write(name, source)
        self._check_open()
        name, path = self._place(name)
        try:
            size = source.stat().st_size
            self._check_bytes(name, size)
            path.parent.mkdir(parents=True, exist_ok=True)
            os.link(source, path)
            self._digests[name] = file_sha256(path)
        except OSError as error:
            path.unlink(missing_ok=True)
            raise disk_error(error, name) from error
        self._bytes += size
        return size

    def _check_bytes(self, name: str, more: int) -> None:
        limit = self._settings.max_upload_bytes
        if self._bytes + more > limit:
            raise too_large(f"is larger than {limit}", name, limit)
        if self._bytes + more - self._space_checked_at >= SPACE_CHECK_BYTES:
            self._space_checked_at = self._bytes + more
            self._check_space()

    @contextmanager
    def committing(self) -> Iterator[None]:
        """Context that takes over the files, removed on errors unless of the database.

        Raises:
            InvalidInputError: no file was sent, or the session is over.
            ResourceError: the disk is full.
        """
        self._check_open()
        try:
            if not self._digests:
                raise InvalidInputError(
                    "the upload has no files", field="files", hint="Send images, an archive or a video."
                )
            yield
        except DatabaseError:
            raise  # the job may exist though the answer was lost; otherwise a worker's cleanup removes the files
        except OSError as error:
            remove(self.folder)
            raise disk_error(error, "files") from error
        except BaseException:
            remove(self.folder)
            raise
        finally:
            self._end()

    def _end(self) -> None:
        self._open = False
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def replace_files(self, folder: Path) -> None:
        """Replaces `raw` by the unpacked `folder`, unless they are the same."""
        if folder != self.raw:
            validated = folder.rename(self.folder / folder.name)
            remove(self.raw)
            self.raw = validated

    @property
    def bytes(self) -> int:
        """Total size of the files."""
        return self._bytes

    def abort(self) -> None:
        """Removes all files; does nothing once the session is over."""
        if self._open:
            self._end()
            if self._file is not None:
                self._file.discard()
            remove(self.folder)

    def digest(self, name: str, options: SceneOptions) -> str:
        """Hex sha256 of name, options and files; equal for equal requests."""
        content = {"name": name, "options": asdict(options), "files": sorted(self._digests.items())}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def _check_open(self) -> None:
        if not self._open:
            raise InvalidInputError("this upload is over", field="upload", hint="Start a new upload.")

    def check_names(self, kind: Source, has_labels: bool) -> None:
        """Rejects duplicate names where poses or label maps refer to them; photos alone may repeat."""
        twice = next(iter(self._files_of_name), None)
        if twice is not None and (kind != "images" or has_labels):
            raise _same_name(twice)

    def _place(self, name: str) -> tuple[str, Path]:
        """Final name and path of a file."""
        parts = safe_parts(name)
        if len(self._digests) >= self._settings.max_entries:
            raise LimitExceededError(
                f"more than {self._settings.max_entries} files",
                field="files",
                limit=f"{self._settings.max_entries} files",
                hint="Send fewer images.",
            )
        path = self.raw.joinpath(*parts)
        folders = [self.raw.joinpath(*parts[:depth]) for depth in range(1, len(parts))]
        if path.is_dir() or any(folder.is_file() for folder in folders):
            raise _same_name(name)
        sent = PurePosixPath(*parts)
        while path.exists():
            self._files_of_name[str(sent)] += 1
            name = str(sent.with_stem(f"{sent.stem} ({self._files_of_name[str(sent)] + 1})"))
            path = self.raw.joinpath(*safe_parts(name))
        return name, path


class UploadFile:
    """A file being written, see `UploadSession.begin`."""

    def __init__(
        self, name: str, path: Path, check_bytes: Callable[[str, int], None], ended: Callable[[str, int, str], None]
    ) -> None:
        self._name = name
        self._path = path
        self._check_bytes = check_bytes
        self._ended = ended
        self._digest = hashlib.sha256()
        self._size = 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb")
        except OSError as error:
            raise disk_error(error, name) from error

    def write(self, chunk: bytes) -> None:
        """Writes bytes of the file.

        Raises:
            LimitExceededError: the upload becomes too large.
            ResourceError: the disk is full, or almost.
        """
        self._size += len(chunk)
        self._check_bytes(self._name, self._size)
        self._digest.update(chunk)
        try:
            self._file.write(chunk)
        except OSError as error:
            raise disk_error(error, self._name) from error

    def end(self) -> int:
        """Adds the file to the upload; returns its bytes. Raises `ResourceError` (disk full)."""
        try:
            self._file.close()
        except OSError as error:
            self.discard()
            raise disk_error(error, self._name) from error
        self._ended(self._name, self._size, self._digest.hexdigest())
        return self._size

    def discard(self) -> None:
        """Removes the file, if it still exists."""
        with suppress(OSError):  # flushing may fail on a full disk
            self._file.close()
        self._path.unlink(missing_ok=True)


def _same_name(name: str) -> InvalidInputError:
    return InvalidInputError(
        f"two files of this upload are called {name!r}", field=name, hint="Give every file its own name."
    )


def _chunks(stream: BinaryIO | Iterable[bytes]) -> Iterable[bytes]:
    read = getattr(stream, "read", None)
    if read is None:
        return stream
    return iter(lambda: read(_CHUNK), b"")


def too_large(said: str, field: str, limit: int) -> LimitExceededError:
    """Makes the error for an upload of which `said` tells the size."""
    return LimitExceededError(
        f"the upload {said} bytes",
        field=field,
        limit=f"{limit} bytes (FASTSPLAT_CAPTURE__MAX_UPLOAD_BYTES)",
        hint="Send fewer or smaller images.",
    )


def disk_error(error: OSError, field: str) -> ResourceError:
    """Converts an operating system's error for the uploader."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    return ResourceError(
        "the server's disk is full" if full else f"the upload cannot be stored: {error.strerror}",
        field=field,
        hint="Free space in the server's data folder, then send the upload again.",
    )
