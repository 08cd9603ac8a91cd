"""Folders under the data directory, and writes that survive a power cut.

uploads/<upload id>     what a client sent, until its job is over
jobs/<operation id>     a running job's stage results and checkpoints
scenes/<id>/<version>   finished artefacts, never changed once there
logs/                   the trainers' last words
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Blobs:
    """Where things are. Every name handed in is an id that this service made."""

    root: Path

    def upload(self, upload_id: str) -> Path:
        """Folder of one upload."""
        return self._folder("uploads", upload_id)

    def job(self, operation_id: str) -> Path:
        """Work folder of one job."""
        return self._folder("jobs", operation_id)

    def log(self, operation_id: str) -> Path:
        """What the job's trainers wrote on stderr."""
        return self._folder("logs", operation_id).with_suffix(".log")

    def scene(self, scene_id: str) -> Path:
        """Folder of all versions of one scene."""
        return self._folder("scenes", scene_id)

    def version(self, scene_id: str, version: str) -> Path:
        """Folder of one version: `artefact/` (see `service.scene`) and `scene.ply`."""
        return self._folder("scenes", scene_id, version)

    def ids(self, kind: str) -> tuple[str, ...]:
        """Names of all folders in `uploads`, `jobs` or `scenes`."""
        folder = self.root / kind
        return tuple(sorted(path.name for path in folder.iterdir())) if folder.is_dir() else ()

    def publish(self, source: Path, scene_id: str, version: str) -> Path:
        """Move a finished folder to its final place, all of it or nothing, durably."""
        target = self.version(scene_id, version)
        target.parent.mkdir(parents=True, exist_ok=True)
        sync_tree(source)
        source.rename(target)
        sync_folder(target.parent)
        sync_folder(target.parent.parent)
        return target

    def _folder(self, *names: str) -> Path:
        for name in names:
            if not name or name.startswith(".") or "/" in name or "\\" in name or "\0" in name:
                raise ValueError(f"not an id: {name!r}")
        return self.root.joinpath(*names)


def remove(path: Path) -> None:
    """Delete a file or folder, whatever of it is still there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def sync_tree(folder: Path) -> None:
    """fsync every file and folder below and including `folder`."""
    for current, _, files in os.walk(folder):
        for name in files:
            _sync(Path(current) / name, os.O_RDONLY)
        sync_folder(Path(current))
    sync_folder(folder.parent)


def sync_folder(folder: Path) -> None:
    """Make what was created in, renamed into or removed from a folder survive a power cut."""
    _sync(folder, os.O_RDONLY | os.O_DIRECTORY)


def _sync(path: Path, flags: int) -> None:
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
