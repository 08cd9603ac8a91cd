"""One image of a whole run: the rendered view and the answer to every question in it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from fastsplat_contract.queries import Answer

_COLUMNS = 3
_WIDTH = 480
_CAPTION = 26
_GAP = 6


def write_sheet(panels: Sequence[tuple[str, Path]], target: Path) -> None:
    """Write pictures (caption and file, in reading order, of one aspect) in rows of three as a JPEG."""
    pictures = [(caption, Image.open(path).convert("RGB")) for caption, path in panels]
    first = pictures[0][1]
    height = round(_WIDTH * first.height / first.width)
    rows = -(-len(pictures) // _COLUMNS)
    columns = min(_COLUMNS, len(pictures))
    size = (columns * (_WIDTH + _GAP) - _GAP, rows * (height + _CAPTION + _GAP) - _GAP)
    sheet = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(15)
    for index, (caption, picture) in enumerate(pictures):
        left = index % _COLUMNS * (_WIDTH + _GAP)
        top = index // _COLUMNS * (height + _CAPTION + _GAP)
        draw.text((left + 2, top + _CAPTION / 2), caption, font=font, fill="black", anchor="lm")
        sheet.paste(picture.resize((_WIDTH, height), Image.Resampling.LANCZOS), (left, top + _CAPTION))
    sheet.save(target, quality=88)


def caption_of(answer: Answer) -> str:
    """A question and its answer, in one line."""
    return f"“{answer.text}” {answer.sentence}"
