"""Draws printable sheets of AprilTags for `service.capture.world.scale_tags`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from fastsplat.service.capture.world.scale_tags import TAG_COUNT, draw_tag
from fastsplat_contract.errors import InvalidInputError

A4_MM = (210.0, 297.0)
_MARGIN_MM, _FOOT_MM = 5.0, 22.0
_MODULE_PX = 100
_RULER_MM = 100
_POINTS_PER_INCH, _MM_PER_INCH = 72, 25.4


def tag_pages(tags: Sequence[int], side_m: float) -> list[NDArray[np.uint8]]:
    """Draws A4 pages of tags with a ruler of 100 mm, at `pixels_per_mm(side_m)`.

    Args:
        tags: different ids, at least one.
        side_m: of the black square, meters.

    Raises:
        InvalidInputError: no tag of that size fits on A4, or there is no such tag.
    """
    cell_mm = 1e3 * side_m * 10 / 8  # with the white border that the square needs
    columns = int((A4_MM[0] - 2 * _MARGIN_MM) / cell_mm)
    rows = int((A4_MM[1] - _MARGIN_MM - _FOOT_MM) / cell_mm)
    if columns * rows == 0:
        limit = (A4_MM[0] - 2 * _MARGIN_MM) * 8 / 10
        raise InvalidInputError(
            f"a tag of {1e3 * side_m:.4g} mm does not fit on A4", field="side_mm", limit=f"{limit:.0f}"
        )
    if side_m < 0.01:
        raise InvalidInputError("tags are this small in no photo", field="side_mm", limit="10 or more")
    if not tags or len(set(tags)) < len(tags) or min(tags) < 0 or max(tags) >= TAG_COUNT:
        raise InvalidInputError("ids must be different tags of the family", field="tags", limit=f"0 to {TAG_COUNT - 1}")
    per_page = columns * rows
    pages = [tags[first : first + per_page] for first in range(0, len(tags), per_page)]
    return [_page(page, columns, side_m) for page in pages]


def pixels_per_mm(side_m: float) -> float:
    """Resolution at which a tag's module is a whole number of pixels."""
    return 8 * _MODULE_PX / (1e3 * side_m)


def write_pdf(pages: Sequence[NDArray[np.uint8]], side_m: float, path: Path) -> None:
    """Writes pages as a PDF in true size."""
    first, *rest = (Image.fromarray(page).convert("1", dither=Image.Dither.NONE) for page in pages)
    resolution = pixels_per_mm(side_m) * _MM_PER_INCH
    first.save(path, "PDF", save_all=True, append_images=rest, resolution=resolution)


def _page(tags: Sequence[int], columns: int, side_m: float) -> NDArray[np.uint8]:
    scale = pixels_per_mm(side_m)
    page = np.full((round(A4_MM[1] * scale), round(A4_MM[0] * scale)), 255, np.uint8)
    cell = 10 * _MODULE_PX
    left = (page.shape[1] - columns * cell) // 2
    for place, tag in enumerate(tags):
        row, column = divmod(place, columns)
        top, start = round(_MARGIN_MM * scale) + row * cell, left + column * cell
        page[top : top + cell, start : start + cell] = draw_tag(tag, _MODULE_PX)
    picture = Image.fromarray(page)
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(size=round(3.5 * scale))
    x, y = round(10 * scale), page.shape[0] - round(14 * scale)
    draw.line([(x, y), (x + round(_RULER_MM * scale), y)], fill=0, width=max(1, round(0.3 * scale)))
    for tick in range(0, _RULER_MM + 1, 10):
        at = x + round(tick * scale)
        draw.line([(at, y - round(1.5 * scale)), (at, y)], fill=0, width=max(1, round(0.3 * scale)))
    text = f"{_RULER_MM} mm. Print at 100 %, and check this line with a ruler. Tags {tags[0]} to {tags[-1]}."
    draw.text((x, y + round(scale)), text, fill=0, font=font)
    return np.asarray(picture)
