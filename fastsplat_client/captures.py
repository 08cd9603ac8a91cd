"""A capture on disk as the parts of an upload."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from service.common.errors import InvalidInputError

_IMAGES = {".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp"}


class CaptureFiles:
    """A folder of photos, or one archive or video. A context manager: its files are open inside.

    Raises:
        InvalidInputError: there is no such file or folder, or no image in it.
    """

    def __init__(self, capture: Path) -> None:
        self._parts = list(_parts(capture))
        self._opened = ExitStack()

    def __enter__(self) -> CaptureFiles:
        return self

    def __exit__(self, *exception: object) -> None:
        self._opened.close()

    def parts(self) -> dict[str, Any]:
        """httpx's `files`, from the first byte on; call it anew for each try."""
        self._opened.close()
        opened = (
            (field, (name, self._opened.enter_context(path.open("rb")), "application/octet-stream"))
            for field, name, path in self._parts
        )
        return {"files": list(opened)}


def _parts(capture: Path) -> Iterator[tuple[str, str, Path]]:
    if capture.is_file():
        yield "capture", capture.name, capture
        return
    if not capture.is_dir():
        raise InvalidInputError(f"there is no {capture}", field="capture")
    images = sorted(path for path in capture.rglob("*") if path.suffix.lower() in _IMAGES)
    if not images:
        raise InvalidInputError(
            f"{capture} holds no images", field="capture", hint=f"These count: {', '.join(sorted(_IMAGES))}."
        )
    for path in images:
        yield "images", path.relative_to(capture).as_posix(), path
