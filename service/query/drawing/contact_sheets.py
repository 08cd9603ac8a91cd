"""Contact contact sheets of objects: each cropped from a view, outlined and numbered."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from fastsplat.service.query.drawing.pictures import U8, jpeg_bytes

MOST_OBJECTS = 20
_SIDE, _LARGEST_CELL = 768, 256
_MARGIN = 0.3
"""Margin around an object, as a share of its longer side."""
_LEAST_SIDE = 12.0
"""Least side of a crop in mask pixels, so that tiny objects keep some context."""
_OUTLINE, _GROUND = (255, 230, 0), (32, 32, 32)


def cell_side(count: int) -> int:
    """Side of each cell in pixels for a sheet of `count` objects."""
    return min(_LARGEST_CELL, _SIDE // _columns(count))


def object_cell(picture: U8, mask: NDArray[np.bool_], side: int) -> U8:
    """Crops and outlines the largest component of an object, uint8 [H, W, 3], in `side` pixels.

    `mask`, bool [h, w], not empty, may have another size than the picture."""
    height, width = mask.shape
    # Stray pixels far from an object would make the crop the whole picture.
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    largest = labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    rows, columns = np.flatnonzero(largest.any(axis=1)), np.flatnonzero(largest.any(axis=0))
    longer = max(rows[-1] + 1 - rows[0], columns[-1] + 1 - columns[0])
    half = max((0.5 + _MARGIN) * longer, _LEAST_SIDE / 2)
    (top, bottom), (left, right) = (
        (max(0, int((at[0] + at[-1] + 1) / 2 - half)), min(most, ceil((at[0] + at[-1] + 1) / 2 + half)))
        for at, most in ((rows, height), (columns, width))
    )
    down, across = picture.shape[0] / height, picture.shape[1] / width
    cut = picture[int(top * down) : ceil(bottom * down), int(left * across) : ceil(right * across)]
    scale = side / max(bottom - top, right - left)
    size = max(1, round((right - left) * scale)), max(1, round((bottom - top) * scale))
    cell = cv2.resize(cut, size, interpolation=cv2.INTER_AREA if cut.shape[1] > size[0] else cv2.INTER_CUBIC)
    grown = cv2.resize(mask[top:bottom, left:right].astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    lines, _ = cv2.findContours((grown > 0.5).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    drawn = np.ascontiguousarray(cell, dtype=np.uint8)
    cv2.drawContours(drawn, lines, -1, _OUTLINE, 1)
    return drawn


def contact_sheet(cells: Sequence[U8]) -> bytes:
    """Arranges numbered cells, from 1, as a JPEG of at most 768 pixels a side.

    At most `MOST_OBJECTS` results of `object_cell`, with `cell_side` as their longer side."""
    columns, side = _columns(len(cells)), cell_side(len(cells))
    sheet = Image.new("RGB", (columns * side, ceil(len(cells) / columns) * side), _GROUND)
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=18)
    for place, cell in enumerate(cells):
        left, top = place % columns * side, place // columns * side
        height, width = cell.shape[:2]
        sheet.paste(Image.fromarray(cell), (left + (side - width) // 2, top + (side - height) // 2))
        at, number = (left + 3, top + 1), str(place + 1)
        pen.rectangle(pen.textbbox(at, number, font=font), fill=(0, 0, 0))
        pen.text(at, number, fill=(255, 255, 255), font=font)
    return jpeg_bytes(np.asarray(sheet))


def _columns(count: int) -> int:
    return ceil(sqrt(count))
