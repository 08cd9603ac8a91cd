"""Detects 360° videos by their MP4 or MOV metadata. For the confined child.

Google's spherical video RFC (https://github.com/google/spatial-media): XML in a `uuid` box, or boxes `st3d` and `sv3d`.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from fastsplat.service.capture.photos.panorama import metadata_value
from fastsplat_contract.errors import InvalidInputError

_V1 = bytes.fromhex("ffcc8263f8554a938814587a02521fdd")
_MOST_XML_BYTES = 1 << 16
_MOST_BOXES = 10_000
_TRACK = ((b"moov", 0), (b"trak", 0))
_ENTRY = (*_TRACK, (b"mdia", 0), (b"minf", 0), (b"stbl", 0), (b"stsd", 8), (b"", 78))
"""Path to a sample entry (ISO/IEC 14496-12): box names, "" for any, and header bytes."""
_VIEW = 5  # bytes of `st3d`; the last is 0 for one eye


def is_spherical(path: Path, name: str) -> bool:
    """Detects an equirectangular video, 360° × 180°, for one eye.

    Raises:
        InvalidInputError: only a part of the sphere, another projection, or for two eyes.
    """
    with path.open("rb") as file:
        boxes = _Boxes(file, path.stat().st_size)
        kinds = [*_stated_by_xml(boxes), *_stated_by_boxes(boxes)]
    bad_kind = next((kind for kind in kinds if kind != "sphere"), None)
    if bad_kind is not None:
        raise InvalidInputError.of(
            name, f"says that it is {bad_kind}", "Export it as an equirectangular video of 360° × 180° for one eye."
        )
    return bool(kinds)


def _stated_by_xml(boxes: _Boxes) -> Iterator[str]:
    for begin, end in boxes.at((*_TRACK, (b"uuid", 0))):
        content = boxes.read(begin, min(end, begin + _MOST_XML_BYTES))
        text = content[len(_V1) :].decode("utf-8", "replace")
        if not content.startswith(_V1) or metadata_value(text, "GSpherical:Spherical").lower() != "true":
            continue
        stereo = metadata_value(text, "GSpherical:StereoMode").lower() not in ("", "mono")
        projection = metadata_value(text, "GSpherical:ProjectionType").lower()
        area_width, whole = (
            metadata_value(text, f"GSpherical:{part}WidthPixels") for part in ("CroppedAreaImage", "FullPano")
        )
        yield _kind(stereo, projection != "equirectangular", area_width != whole and "" not in (area_width, whole))


def _stated_by_boxes(boxes: _Boxes) -> Iterator[str]:
    stereo = any(
        any(boxes.read(begin, min(end, begin + _VIEW))[_VIEW - 1 :]) for begin, end in boxes.at((*_ENTRY, (b"st3d", 0)))
    )
    for place in boxes.at((*_ENTRY, (b"sv3d", 0), (b"proj", 0))):
        whole = list(boxes.at(((b"equi", 0),), place))
        bounds = [boxes.read(begin, min(end, begin + 20))[4:] for begin, end in whole]
        yield _kind(stereo, not whole, any(any(bound) for bound in bounds))


def _kind(stereo: bool, projected: bool, part: bool) -> str:
    if stereo:
        return "for two eyes"
    return "a sphere in another projection" if projected else "a part of a sphere" if part else "sphere"


class _Boxes:
    """Reads the boxes of a file, up to a limit."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._size, self._left = file, size, _MOST_BOXES

    def read(self, begin: int, end: int) -> bytes:
        """Reads the bytes from `begin` to `end`."""
        self._file.seek(begin)
        return self._file.read(end - begin)

    def at(
        self, names: tuple[tuple[bytes, int], ...], place: tuple[int, int] | None = None
    ) -> Iterator[tuple[int, int]]:
        """Finds contents (begin, end) of nested boxes below `place`; `names` as in `_ENTRY`."""
        if not names:
            yield place or (0, self._size)
            return
        (name, skipped), *rest = names
        for kind, begin, end in self._in(*(place or (0, self._size))):
            if name in (b"", kind) and begin + skipped <= end:
                yield from self.at(tuple(rest), (begin + skipped, end))

    def _in(self, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
        while start + 8 <= end and self._left:
            self._left -= 1
            head = self.read(start, min(start + 16, end))
            size, kind = struct.unpack_from(">I4s", head)
            header = 8
            if size == 1 and len(head) == 16:
                (size,), header = struct.unpack_from(">Q", head, 8), 16
            size = size or end - start
            if size < header or start + size > end:
                return
            yield kind, start + header, start + size
            start += size
