"""A sheet of things: each cut from a picture of a view, outlined and numbered."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from fastsplat.service.query.drawing.pictures import U8, jpeg_bytes

MOST_THINGS = 20
_SIDE, _LARGEST_CELL = 768, 256
_MARGIN = 0.3
"""Of a thing's longer side, around it."""
_LEAST_SIDE = 12.0
"""Pixels of the mask that a cut has at least, so that a tiny thing is seen with what is around it."""
_OUTLINE, _GROUND = (255, 230, 0), (32, 32, 32)


def cell_side(count: int) -> int:
    """Pixels of the square that each of so many things has on their sheet."""
    return min(_LARGEST_CELL, _SIDE // _columns(count))


def thing_cell(picture: U8, mask: NDArray[np.bool_], side: int) -> U8:
    """uint8 [H, W, 3], the longer side `side` pixels: the largest connected part of a thing with what is around it, and
    a line around what is the thing's.

    Args:
        picture: uint8 [H, W, 3] of a whole view.
        mask: bool [h, w] of the same view in any size: where the thing is; not empty.
        side: pixels.
    """
    height, width = mask.shape
    # Single pixels far from a thing would make its cut the whole picture.
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
    shown = cv2.resize(cut, size, interpolation=cv2.INTER_AREA if cut.shape[1] > size[0] else cv2.INTER_CUBIC)
    grown = cv2.resize(mask[top:bottom, left:right].astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    lines, _ = cv2.findContours((grown > 0.5).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    drawn = np.ascontiguousarray(shown, dtype=np.uint8)
    cv2.drawContours(drawn, lines, -1, _OUTLINE, 1)
    return drawn


def thing_sheet(cells: Sequence[U8]) -> bytes:
    """A JPEG of at most 768 pixels a side: cells in rows, each with its number, from 1, in its upper left corner.

    Args:
        cells: 1 to `MOST_THINGS` of `thing_cell`, their longer side `cell_side`.
    """
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
