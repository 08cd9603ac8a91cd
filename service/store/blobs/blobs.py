"""Folders of the data directory, with writes that survive a power cut.

uploads/<upload id>     uploaded files, until the job has succeeded; kept longer if it failed or was cancelled;
                        or the one file `data` that comes in pieces, whose bytes behind its row's offset do not count
jobs/<run id>           stage results and checkpoints of a running job, and progress files in progress/
scenes/<id>/<version>   finished artefacts, never changed
logs/<operation id>.log stderr of the trainers
trash/                  being removed; in trash/scenes/<scene id>.<second> scenes that lost their rows
.identity               see `service.store.rows.identity`

Several machines may share the data directory. If they do not, uploads and scenes are kept in an object store
(`service.store.blobs.object_store`), and `scenes` here is a cache.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

from fastsplat.service.common.files import atomic_file, publish_directory, sync_directory, sync_tree
from fastsplat.service.store.blobs.activity_clock import ActivityClock
from fastsplat.service.store.blobs.file_digests import check_files, write_digests
from fastsplat_contract.errors import NotFoundError, ResourceError, UploadLockedError

PARTIAL_EXPIRY_S = 24 * 3600.0
"""Interrupted copies to and from the object store are removed after this time."""

_IDENTITY = ".identity"
_DATA = "data"


@dataclass(frozen=True)
class Blobs:
    """Folders and files of the data directory; all names are ids made by this service."""

    root: Path

    def identity(self) -> str | None:
        """Returns the id that the storage shares with its database, or None."""
        try:
            return (self.root / _IDENTITY).read_text().strip() or None
        except FileNotFoundError:
            return None

    def keep_identity(self, identity: str, *, replace: bool = False) -> str:
        """Stores an id durably, unless one is there and not `replace`.

        Returns the stored id; raises `ResourceError` if it cannot be written.
        """
        try:
            with atomic_file(self.root / _IDENTITY, replace=replace) as path:
                path.write_text(identity)
        except FileExistsError:  # another process was faster
            return self.identity() or ""
        except OSError as error:
            raise ResourceError(
                f"the data folder cannot be written: {error.strerror}",
                field="data_dir",
                hint="Free space, or make the folder writable for the service.",
            ) from error
        return identity

    def upload(self, upload_id: str) -> Path:
        """Folder of an upload on this machine."""
        return self._folder("uploads", upload_id)

    def job(self, run_id: str) -> Path:
        """Work folder of a job's run."""
        return self._folder("jobs", run_id)

    def progress_file(self, run_id: str, name: str) -> Path:
        """Path on this machine of a progress file, shown while its job runs; see `OperationRecord`."""
        return self._folder("jobs", run_id, "progress", name)

    def keep_progress_file(self, run_id: str, name: str) -> None:
        """Makes a complete progress file visible on all machines."""

    def read_progress_file(self, run_id: str, name: str) -> bytes | None:
        """Reads a progress file wherever the job runs; None if it does not exist."""
        try:
            return self.progress_file(run_id, name).read_bytes()
        except FileNotFoundError:
            return None

    def drop_progress_file(self, run_id: str, name: str) -> None:
        remove(self.progress_file(run_id, name))

    def keep_result(self, run_id: str, stage: str, attempt: int) -> None:
        """Makes the result of a stage, as an attempt finished it, available to workers everywhere."""

    def fetch_result(self, run_id: str, stage: str, attempt: int) -> bool:
        """Brings what `keep_result` was given to the stage's place, where nothing is; False if it is not stored."""
        return False

    def drop_job(self, run_id: str) -> None:
        remove(self.job(run_id))

    def log(self, operation_id: str) -> Path:
        """Path on this machine of the stderr of the job's trainers."""
        return self._folder("logs", f"{operation_id}.log")

    def keep_log(self, operation_id: str) -> None:
        """Makes a log, as it is now, visible on all machines."""

    def read_log(self, operation_id: str, most: int) -> bytes | None:
        """Reads the last `most` bytes of a log wherever the job runs; None if it does not exist."""
        try:
            with self.log(operation_id).open("rb") as file:
                file.seek(max(0, os.fstat(file.fileno()).st_size - most))
                return file.read()
        except FileNotFoundError:
            return None

    def drop_log(self, operation_id: str) -> None:
        remove(self.log(operation_id))

    def remove_old_logs(self, retention_s: float) -> None:
        """Removes logs that have not changed for so long."""
        for path in (self.root / "logs").glob("*.log"):
            with suppress(FileNotFoundError):  # another worker removed it first
                if time.time() - path.stat().st_mtime > retention_s:
                    path.unlink()

    def version(self, scene_id: str, version: str) -> Path:
        """Folder of a version on this machine: `artefact/`, `scene.ply`, `photos/`, `files.sha256`."""
        return self._folder("scenes", scene_id, version)

    def ids(self, kind: str) -> tuple[str, ...]:
        """Lists folder names of `uploads`, `jobs` or `scenes`, wherever they are kept."""
        folder = self.root / kind
        return tuple(sorted(path.name for path in folder.iterdir())) if folder.is_dir() else ()

    def clock(self, wall: Callable[[], float] = time.time) -> Callable[[], float]:
        """The clock by which resumable uploads expire, in seconds since 1970."""
        return ActivityClock(self.root, wall).now

    def begin_data(self, upload_id: str) -> None:
        """Makes the empty file of a resumable upload; durable."""
        folder = self.upload(upload_id)
        folder.mkdir(parents=True)
        with (folder / _DATA).open("x") as file:
            os.fsync(file.fileno())
        sync_directory(folder)
        sync_directory(folder.parent)

    def open_data(self, upload_id: str, offset: int) -> FileIO:
        """Opens a resumable upload's file to append at `offset`, locked until it is closed.

        Raises:
            NotFoundError: the file is gone.
            UploadLockedError: another piece is being written.
        """
        try:
            data = (self.upload(upload_id) / _DATA).open("r+b", buffering=0)
        except OSError:
            raise no_data(upload_id) from None
        try:
            fcntl.flock(data, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            data.close()
            raise UploadLockedError(
                "another piece of this upload is coming in",
                field="upload",
                hint="Wait until it has ended, ask for the offset, then go on.",
            ) from None
        data.seek(offset)
        return data

    def keep_data(self, upload_id: str, data: FileIO, begin: int, end: int) -> tuple[str, ...]:
        """Makes bytes of an opened file durable; returns the names of their objects in an object store."""
        os.fsync(data.fileno())
        return ()

    def read_data(self, upload_id: str, pieces: Sequence[str]) -> Path | Iterator[bytes]:
        """Returns the path, or reads the objects, of a complete file; raises `NotFoundError` if it is gone."""
        path = self.upload(upload_id) / _DATA
        if not path.is_file():
            raise no_data(upload_id)
        return path

    def keep_upload(self, upload_id: str) -> None:
        """Makes a complete upload durable and visible to workers everywhere."""
        folder = self.upload(upload_id)
        sync_tree(folder)
        sync_directory(folder.parent)

    def fetch_upload(self, upload_id: str) -> Path:
        """Returns the local folder of a complete upload."""
        return self.upload(upload_id)

    def drop_upload(self, upload_id: str) -> None:
        self._discard(self.upload(upload_id))

    def upload_age(self, upload_id: str) -> float:
        """Seconds since an upload changed; 0 while being written."""
        folder = self.upload(upload_id)
        try:
            if _is_locked(folder):
                return 0.0
            return time.time() - max(path.stat().st_mtime for path in (folder, *folder.rglob("*")))
        except OSError:
            return 0.0

    def publish(self, source: Path, scene_id: str, version: str) -> Path:
        """Moves a finished folder to its final place, atomically and durably, with file digests.

        Returns:
            Its new path on this machine.

        Raises:
            OSError: that version is there already, or the disk is full.
        """
        target = self.version(scene_id, version)
        target.parent.mkdir(parents=True, exist_ok=True)
        write_digests(source)
        publish_directory(source, target)
        sync_directory(target.parent.parent)
        return target

    def fetch_version(self, scene_id: str, version: str) -> Path | None:
        """Returns the local, complete folder of a published version; None if it does not exist."""
        folder = self.version(scene_id, version)
        return folder if folder.is_dir() else None

    def check_version(self, folder: Path, *names: str) -> None:
        """Checks a version's files (default: all) against their digests; `SceneFileError` names a bad one."""
        check_files(folder, *names)

    def drop_version(self, scene_id: str, version: str) -> None:
        """Removes a version; readers of open files are not disturbed."""
        self._discard(self.version(scene_id, version))

    def versions(self) -> dict[tuple[str, str], float]:
        """Maps (scene id, version) to the time of publication, in seconds since 1970."""
        published = {}
        for folder in (self.root / "scenes").glob("[!.]*/[!.]*"):
            with suppress(FileNotFoundError):  # removed meanwhile
                published[folder.parent.name, folder.name] = folder.stat().st_mtime
        return published

    def trash_version(self, scene_id: str, version: str, now: float) -> None:
        """Moves a version to the trash at `now`, in seconds since 1970."""
        self._trash(("scenes", scene_id, version), trash_name(f"{scene_id}.{version}", now))

    def drop_scene(self, scene_id: str) -> None:
        """Removes all versions of a scene; readers of open files are not disturbed."""
        self._discard(self._folder("scenes", scene_id))

    def trash_scene(self, scene_id: str, now: float) -> None:
        """Moves all versions of a scene to the trash at `now`, in seconds since 1970."""
        self._trash(("scenes", scene_id), trash_name(scene_id, now))

    def _trash(self, folder: tuple[str, ...], name: str) -> None:
        target = self._folder("trash", "scenes", name)
        target.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):  # another worker moved it first
            self._folder(*folder).rename(target)

    def trashed_scenes(self) -> tuple[str, ...]:
        """Lists trashed scenes ("<scene id>.<second>") and versions ("<scene id>.<version>.<second>")."""
        return self.ids("trash/scenes")

    def drop_trashed(self, name: str) -> None:
        self._discard(self._folder("trash", "scenes", name))

    def half_removed(self) -> tuple[Path, ...]:
        """Lists folders whose removal was interrupted or is under way."""
        return tuple(sorted(path for path in (self.root / "trash").glob("*") if path.name != "scenes"))

    def remove_partial(self, expiry_s: float) -> None:
        """Removes what interrupted removals left; see `ObjectStoreBlobs` for `expiry_s`."""
        for path in self.half_removed():
            remove(path)

    def _discard(self, path: Path) -> None:
        # Renamed first, so that nobody sees a half-removed folder.
        trash = self.root / "trash"
        try:
            trash.mkdir(parents=True, exist_ok=True)
            path = path.rename(trash / uuid.uuid4().hex)
        except OSError:
            pass  # gone already; or the disk is full, and removing in place must do
        remove(path)

    def _folder(self, *names: str) -> Path:
        for name in names:
            if not name or name.startswith(".") or "/" in name or "\\" in name or "\0" in name:
                raise ValueError(f"not an id: {name!r}")
        return self.root.joinpath(*names)


def no_data(upload_id: str) -> NotFoundError:
    """Makes the error for a resumable upload whose bytes are gone."""
    return NotFoundError(f"no upload {upload_id!r}", field="upload", hint="Its file is gone: start anew.")


def trash_name(name: str, now: float) -> str:
    """Name in the trash, with the time, as copies lose a file's own time."""
    return f"{name}.{int(now)}"


def lock_of(folder: Path) -> int | None:
    """Locks a folder to mark it as being written; None without file locks."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        return None
    return handle


def _is_locked(folder: Path) -> bool:
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False  # no locks here: the ages of the files must do
    finally:
        os.close(handle)
    return False


def remove(path: Path) -> None:
    """Deletes a file or folder, or what is left of it."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
