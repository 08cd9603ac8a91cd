"""One upload: files come in, bounded and safely named, and become a job or leave no trace."""

from __future__ import annotations

import errno
import hashlib
import json
import os
from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.common.file_names import safe_parts
from fastsplat.service.store.blobs import remove
from fastsplat_contract.errors import DatabaseError, InvalidInputError, LimitExceededError, ResourceError
from fastsplat_contract.operations import Operation, SceneOptions

_CHUNK = 1 << 20


class UploadSession:
    """Files of one future scene, kept in a folder of their own until `commit`: `raw` inside `folder`.

    A context manager: leaving it without a commit removes everything. One thread at a time.
    """

    def __init__(
        self,
        upload_id: str,
        folder: Path,
        settings: CaptureSettings,
        admit: Callable[[UploadSession, str, str, SceneOptions], Operation],
        owner: str = "",
    ) -> None:
        self.id = upload_id
        self.owner = owner
        self.folder = folder
        self.raw = folder / "raw"
        self._settings = settings
        self._admit = admit
        self._digests: dict[str, str] = {}
        self._bytes = 0
        self._open = True
        try:
            self.raw.mkdir(parents=True)
        except OSError as error:
            raise disk_error(error, "upload") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.abort()

    def write(self, name: str, stream: BinaryIO | Iterable[bytes]) -> int:
        """Take one file; folders in its name are kept. Returns its size in bytes.

        Args:
            name: a relative path with forward slashes, e.g. "images/0001.jpg".
            stream: a binary file to read to its end, or chunks of bytes.

        Raises:
            InvalidInputError: the name is unsafe or was used before in this upload, or the session is over.
            LimitExceededError: too many bytes or files; nothing more can be written, so call `abort`.
            ResourceError: the disk is full.
        """
        self._check_open()
        path = self._place(name)
        digest = hashlib.sha256()
        size = 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("xb") as file:
                for chunk in _chunks(stream):
                    size += len(chunk)
                    self._check_bytes(name, size)
                    digest.update(chunk)
                    file.write(chunk)
        except OSError as error:
            path.unlink(missing_ok=True)
            raise disk_error(error, name) from error
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        self._bytes += size
        self._digests[name] = digest.hexdigest()
        return size

    def adopt(self, name: str, source: Path) -> int:
        """Take a file that lies in the data folder already, without a copy. Returns its size in bytes.

        Args:
            name: as in `write`.
            source: on the same disk; it must never change again.

        Raises:
            InvalidInputError, LimitExceededError, ResourceError: as `write`.
        """
        self._check_open()
        path = self._place(name)
        try:
            size = source.stat().st_size
            self._check_bytes(name, size)
            path.parent.mkdir(parents=True, exist_ok=True)
            os.link(source, path)
            with path.open("rb") as file:
                self._digests[name] = hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            path.unlink(missing_ok=True)
            raise disk_error(error, name) from error
        self._bytes += size
        return size

    def _check_bytes(self, name: str, more: int) -> None:
        limit = self._settings.max_upload_bytes
        if self._bytes + more > limit:
            raise LimitExceededError(
                f"the upload is larger than {limit} bytes",
                field=name,
                limit=f"{limit} bytes (FASTSPLAT_CAPTURE__MAX_UPLOAD_BYTES)",
                hint="Send fewer or smaller images.",
            )

    def commit(self, name: str, request_id: str, options: SceneOptions) -> Operation:
        """Check what came, and queue its job. Durable once this returns; the session is over either way.

        Args:
            name: the scene's name for people; may be empty.
            request_id: the same id with the same content returns the same operation; "" for none.
            options: see `SceneOptions`.

        Raises:
            ConflictError: the request id was used before for other content.
            FastSplatError: whatever `service.capture.validate_upload` has against the files, typed; nothing is left.
        """
        self._check_open()
        try:
            if not self._digests:
                raise InvalidInputError(
                    "the upload has no files", field="files", hint="Send images, an archive or a video."
                )
            return self._admit(self, name, request_id, options)
        except DatabaseError:
            raise  # the job may be there although the answer was lost; if it is not, the janitor removes the files
        except OSError as error:
            remove(self.folder)
            raise disk_error(error, "files") from error
        except BaseException:
            remove(self.folder)
            raise
        finally:
            self._open = False

    @property
    def bytes(self) -> int:
        """What the files weigh that have come."""
        return self._bytes

    def abort(self) -> None:
        """Forget all that came. Does nothing after a commit."""
        if self._open:
            self._open = False
            remove(self.folder)

    def digest(self, name: str, options: SceneOptions) -> str:
        """Hex sha256 of everything the user sent: two requests with the same digest are the same request."""
        content = {"name": name, "options": asdict(options), "files": sorted(self._digests.items())}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def _check_open(self) -> None:
        if not self._open:
            raise InvalidInputError("this upload is over", field="upload", hint="Start a new upload.")

    def _place(self, name: str) -> Path:
        parts = safe_parts(name)
        if len(self._digests) >= self._settings.max_entries:
            raise LimitExceededError(
                f"more than {self._settings.max_entries} files",
                field="files",
                limit=f"{self._settings.max_entries} files (FASTSPLAT_CAPTURE__MAX_ENTRIES)",
                hint="Send fewer images.",
            )
        path = self.raw.joinpath(*parts)
        folders = [self.raw.joinpath(*parts[:depth]) for depth in range(1, len(parts))]
        if path.exists() or any(folder.is_file() for folder in folders):
            raise InvalidInputError(
                f"two files of this upload are called {name!r}", field=name, hint="Give every file its own name."
            )
        return path


def _chunks(stream: BinaryIO | Iterable[bytes]) -> Iterable[bytes]:
    read = getattr(stream, "read", None)
    if read is None:
        return stream
    return iter(lambda: read(_CHUNK), b"")


def disk_error(error: OSError, field: str) -> ResourceError:
    """What an operating system's error says to the one who uploads."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    return ResourceError(
        "the server's disk is full" if full else f"the upload cannot be stored: {error.strerror}",
        field=field,
        hint="Free space in the server's data folder, then send the upload again.",
    )
