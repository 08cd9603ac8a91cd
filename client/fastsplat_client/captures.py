"""A capture on disk as the parts of an upload."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from fastsplat_contract.errors import InvalidInputError

_IMAGES = {".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp"}


class CaptureFiles:
    """The photos of a folder; none of a file, which travels on its own. A context manager: they are open inside.

    Raises:
        InvalidInputError: there is no such file or folder, or no image in it.
    """

    def __init__(self, capture: Path) -> None:
        self._images = list(_images(capture))
        self._opened = ExitStack()

    def __enter__(self) -> CaptureFiles:
        return self

    def __exit__(self, *exception: object) -> None:
        self._opened.close()

    def form(self, fields: Sequence[tuple[str, str]]) -> list[tuple[str, Any]]:
        """httpx's `files` of a form with these fields and the photos, from the first byte on; call it for each try."""
        self._opened.close()
        photos = [
            ("images", (name, self._opened.enter_context(path.open("rb")), "application/octet-stream"))
            for name, path in self._images
        ]
        return [*((field, (None, value)) for field, value in fields), *photos]


def _images(capture: Path) -> Iterator[tuple[str, Path]]:
    if capture.is_file():
        return
    if not capture.is_dir():
        raise InvalidInputError(f"there is no {capture}", field="capture")
    images = sorted(path for path in capture.rglob("*") if path.suffix.lower() in _IMAGES)
    if not images:
        raise InvalidInputError(
            f"{capture} holds no images", field="capture", hint=f"These count: {', '.join(sorted(_IMAGES))}."
        )
    for path in images:
        yield path.relative_to(capture).as_posix(), path
