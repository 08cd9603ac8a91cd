"""Collects the files of a capture folder for upload."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, BinaryIO

from fastsplat_contract.errors import InvalidInputError

_PHOTOS = {".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp", ".heic", ".heif"}
_SPLATS = {".ply", ".spz", ".sog", ".splat", ".ksplat"}
_VIDEOS = {".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm"}
_NOT_READ = {".avif", ".dng", ".cr2", ".nef", ".arw", ".gif", ".exr"}
"""Unsupported formats, sent because the server's error explains what to do."""
_COLMAP = {f"{part}{suffix}" for part in ("cameras", "images", "points3D") for suffix in (".bin", ".txt")}
_DEPTHS = {".npy", ".depth", ".conf"}
_SENT = _PHOTOS | _VIDEOS | _NOT_READ | _SPLATS | _DEPTHS | {".json"}
_METADATA = "metadata"
"""Record3D's metadata file, which has no suffix."""
_LITTER = {"__MACOSX", "Thumbs.db", "desktop.ini"}


class CaptureFiles(AbstractContextManager["CaptureFiles"]):
    """The capture files of a folder (none for a single file); a context manager.

    Hidden and system files are left out. `photos` is a folder of photos to be sent with the splat `capture`.

    Raises:
        InvalidInputError: the file or folder does not exist, or has no photo, video or splat; or two names clash.
    """

    def __init__(self, capture: Path, photos: Path | None = None) -> None:
        files = _files(capture) if photos is None else _with_splat(_files(photos), capture)
        self._files = [(name, _LateFile(path)) for name, path in files]

    def __exit__(self, *exception: object) -> None:
        for _, file in self._files:
            file.close()

    def form(self, fields: Sequence[tuple[str, str]]) -> list[tuple[str, Any]]:
        """Builds httpx's `files` with these fields and all files; call it for each try."""
        files = [("files", (name, file, "application/octet-stream")) for name, file in self._files]
        return [*((field, (None, value)) for field, value in fields), *files]


class _LateFile:
    """File opened by its first read and closed by its last, for large forms."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: BinaryIO | None = None

    def read(self, size: int) -> bytes:
        if self._file is None:
            self._file = self._path.open("rb")
        data = self._file.read(size)
        if not data:
            self.close()
        return data

    def tell(self) -> int:
        return 0 if self._file is None else self._file.tell()

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Supports only start and end; returns the length for the end, without opening the file."""
        if whence == os.SEEK_END:
            return self._path.stat().st_size
        self.close()
        return 0

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


def _files(capture: Path) -> list[tuple[str, Path]]:
    if capture.is_file():
        return []
    if not capture.is_dir():
        raise InvalidInputError(f"{capture} does not exist", field="capture")
    files = [(path.relative_to(capture), path) for path in sorted(capture.rglob("*")) if path.is_file()]
    sent = [(name.as_posix(), path) for name, path in files if _is_sent(name)]
    if not any(path.suffix.lower() in _PHOTOS | _VIDEOS | _SPLATS | _NOT_READ for _, path in sent):
        raise InvalidInputError(
            f"{capture} holds no photos, no video and no splat",
            field="capture",
            hint=f"These count: {', '.join(sorted(_PHOTOS | _VIDEOS | _SPLATS))}.",
        )
    return sent


def _with_splat(files: list[tuple[str, Path]], splat: Path) -> list[tuple[str, Path]]:
    rest = [(name, path) for name, path in files if not path.samefile(splat)]
    if any(name == splat.name for name, _ in rest):
        raise InvalidInputError(
            f"there is another file called {splat.name} among the photos", field="photos", hint="Rename one of them."
        )
    return [(splat.name, splat), *rest]


def _is_sent(name: Path) -> bool:
    if any(part in _LITTER or part.startswith(".") for part in name.parts):
        return False
    return name.suffix.lower() in _SENT or name.name in _COLMAP or name.name == _METADATA
