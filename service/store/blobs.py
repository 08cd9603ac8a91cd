"""Folders under the data directory, and writes that survive a power cut.

uploads/<upload id>     what a client sent, until its job has succeeded; a while longer if it failed or was cancelled
jobs/<run id>           a running job's stage results and checkpoints, and in progress/ what can be looked at meanwhile
scenes/<id>/<version>   finished artefacts, never changed once there
logs/                   stderr of the trainers
locks/<scene id>        held while a scene is edited
trash/                  what is being removed; in trash/scenes/<scene id>.<second> scenes that lost their rows
.identity               see `service.store.identity`

The data directory may be a folder that several machines share. Where they share none, uploads and scenes are kept in an
object store instead, see `service.store.object_store`; then `scenes` here is a cache.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from fastsplat.service.common.atomic import atomic_file, publish_directory, sync_directory, sync_tree
from fastsplat.service.common.call_scheduling import wait_elsewhere
from fastsplat.service.store.activity_clock import ActivityClock
from fastsplat.service.store.file_digests import check_files, write_digests
from fastsplat_contract.errors import ResourceError

PARTIAL_EXPIRY_S = 24 * 3600.0
"""Copies to and from the object store that broke off are removed after this."""

RESUMABLE_MARK = "offset"
"""File of an unfinished resumable upload; when it was changed says how old the upload is, by `ActivityClock`."""

_LOCK_POLL_S = 0.02
_IDENTITY = ".identity"


@dataclass(frozen=True)
class Blobs:
    """Paths of folders and files. Every name handed in is an id that this service made."""

    root: Path

    def identity(self) -> str | None:
        """The id that the place of the scenes shares with its database; None if it has none yet."""
        try:
            return (self.root / _IDENTITY).read_text().strip() or None
        except FileNotFoundError:
            return None

    def keep_identity(self, identity: str, *, replace: bool = False) -> str:
        """Write that id, durably, unless one is there and not to be replaced. Returns the one that is there then.

        Raises:
            ResourceError: it cannot be written.
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
        """Folder of one upload on this machine."""
        return self._folder("uploads", upload_id)

    def job(self, run_id: str) -> Path:
        """Work folder of one run of a job."""
        return self._folder("jobs", run_id)

    def progress_file(self, run_id: str, name: str) -> Path:
        """A small file of a running job, on this machine, that can be looked at; see `OperationRecord`."""
        return self._folder("jobs", run_id, "progress", name)

    def keep_progress_file(self, run_id: str, name: str) -> None:
        """Make such a file, which is complete, visible everywhere."""

    def read_progress_file(self, run_id: str, name: str) -> bytes | None:
        """Such a file's bytes, wherever the job runs; None if it is not there (any more)."""
        try:
            return self.progress_file(run_id, name).read_bytes()
        except FileNotFoundError:
            return None

    def drop_progress_file(self, run_id: str, name: str) -> None:
        """Remove such a file, if it is there."""
        remove(self.progress_file(run_id, name))

    def drop_job(self, run_id: str) -> None:
        """Remove a job's work folder, whatever of it is still there."""
        remove(self.job(run_id))

    def log(self, operation_id: str) -> Path:
        """What the job's trainers wrote on stderr."""
        return self._folder("logs", operation_id).with_suffix(".log")

    def version(self, scene_id: str, version: str) -> Path:
        """Folder of one version on this machine: `artefact/` (see `service.scene`), `scene.ply`, `photos/`,
        `files.sha256`."""
        return self._folder("scenes", scene_id, version)

    def ids(self, kind: str) -> tuple[str, ...]:
        """Names of all folders in `uploads`, `jobs` or `scenes`, wherever they are kept."""
        folder = self.root / kind
        return tuple(sorted(path.name for path in folder.iterdir())) if folder.is_dir() else ()

    def keep_upload(self, upload_id: str) -> None:
        """Make a complete upload durable, and visible to workers everywhere."""
        folder = self.upload(upload_id)
        sync_tree(folder)
        sync_directory(folder.parent)

    def fetch_upload(self, upload_id: str) -> Path:
        """Folder of a kept upload, complete, on this machine."""
        return self.upload(upload_id)

    def drop_upload(self, upload_id: str) -> None:
        """Remove an upload, whatever of it is still there."""
        self._discard(self.upload(upload_id))

    def upload_age(self, upload_id: str) -> float:
        """Seconds since anything of an upload changed; 0 if somebody is changing it right now, whatever the clock says.

        A resumable upload is as old as its last piece, by `ActivityClock`.
        """
        folder = self.upload(upload_id)
        try:
            if (mark := folder / RESUMABLE_MARK).exists():
                return ActivityClock(self.root).now() - mark.stat().st_mtime
            if _is_locked(folder):
                return 0.0
            return time.time() - max(path.stat().st_mtime for path in (folder, *folder.rglob("*")))
        except OSError:
            return 0.0

    def publish(self, source: Path, scene_id: str, version: str) -> Path:
        """Move a finished folder to its final place, all of it or nothing, durably, with the digests of its files.

        Returns:
            Where it now is on this machine.

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
        """Folder of a published version, complete, on this machine; None if there is none (any more)."""
        folder = self.version(scene_id, version)
        return folder if folder.is_dir() else None

    def check_version(self, folder: Path, *names: str) -> None:
        """Check files of a version's folder, by default all, against the digests that were published with them.

        Raises:
            SceneFileError: one is damaged or missing; names it.
        """
        check_files(folder, *names)

    def drop_version(self, scene_id: str, version: str) -> None:
        """Remove one version; those who have its files open may read on."""
        self._discard(self.version(scene_id, version))

    def versions(self) -> dict[tuple[str, str], float]:
        """When each version was published, by scene and name, wherever they are kept; seconds since 1970."""
        published = {}
        for folder in (self.root / "scenes").glob("[!.]*/[!.]*"):
            with suppress(FileNotFoundError):  # removed meanwhile
                published[folder.parent.name, folder.name] = folder.stat().st_mtime
        return published

    def trash_version(self, scene_id: str, version: str, now: float) -> None:
        """Move one version to the trash, at `now`, in seconds since 1970."""
        self._trash(("scenes", scene_id, version), trash_name(f"{scene_id}.{version}", now))

    @contextmanager
    def exclusive(self, scene_id: str) -> Iterator[None]:
        """A block that one thread of one process of this machine runs at a time for a scene; the others wait, without a
        thread if they can be made again. To be entered before anything is changed.

        Raises:
            CancelledError, DeadlineExceededError, CallAgainError: as `wait_elsewhere`.
        """
        path = self._folder("locks", scene_id)
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("ab") as file:
            while True:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    wait_elsewhere(_LOCK_POLL_S)
            yield

    def drop_scene(self, scene_id: str) -> None:
        """Remove all versions of a scene; those who have its files open may read on."""
        self._discard(self._folder("scenes", scene_id))
        remove(self._folder("locks", scene_id))

    def trash_scene(self, scene_id: str, now: float) -> None:
        """Move all versions of a scene to the trash, at `now`, in seconds since 1970."""
        self._trash(("scenes", scene_id), trash_name(scene_id, now))

    def _trash(self, folder: tuple[str, ...], name: str) -> None:
        target = self._folder("trash", "scenes", name)
        target.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):  # another worker moved it first
            self._folder(*folder).rename(target)

    def trashed_scenes(self) -> tuple[str, ...]:
        """What `trash_scene` and `trash_version` moved: "<scene id>.<second>", "<scene id>.<version>.<second>"."""
        return self.ids("trash/scenes")

    def drop_trashed(self, name: str) -> None:
        """Remove one of `trashed_scenes`."""
        self._discard(self._folder("trash", "scenes", name))

    def half_removed(self) -> tuple[Path, ...]:
        """What was being removed when a process ended, or is being removed now."""
        return tuple(sorted(path for path in (self.root / "trash").glob("*") if path.name != "scenes"))

    def remove_partial(self, expiry_s: float) -> None:
        """Remove what crashes left half-written or half-removed; what is younger than `expiry_s` may be in use."""
        for path in self.half_removed():
            remove(path)

    def _discard(self, path: Path) -> None:
        # Renamed first: nobody ever sees half of it.
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


def trash_name(name: str, now: float) -> str:
    """How a scene or a version is called in the trash. It says when it came there, which copies of the folder keep."""
    return f"{name}.{int(now)}"


def lock_of(folder: Path) -> int | None:
    """An open handle whose lock says that a folder is being written to; the kernel takes it back from a process that
    dies. None where the file system has no locks."""
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
    """Delete a file or folder, whatever of it is still there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
