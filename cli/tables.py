"""Formats tables of at most 80 columns, facts, numbers, sizes and times."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from datetime import datetime
from io import StringIO
from typing import Literal, NamedTuple

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

WIDTH = 80
"""Columns of a terminal that every table fits into."""
_GAP = 2
_SIZES = ("kB", "MB", "GB", "TB", "PB", "EB")


class Column(NamedTuple):
    """One column of a table.

    Attributes:
        heading: above it; "" for none.
        fit: what becomes of text that finds no room: cut (with "…"), or wrapped into several lines; "whole" is for
            short text of few letters, as numbers, ids, dates, states.
        right: numbers stand at the right.
    """

    heading: str
    fit: Literal["whole", "cut", "wrap"] = "whole"
    right: bool = False


def table(columns: Sequence[Column], rows: Iterable[Sequence[str]]) -> str:
    """Lines of at most `WIDTH` columns; "" without rows."""
    # Names are typed by anybody: nothing may move the cursor or color the terminal.
    cells = [[re.sub(r"\s", " ", text) for text in row] for row in rows]
    cells = [["".join(letter if letter.isprintable() else "?" for letter in text) for text in row] for row in cells]
    if not cells:
        return ""
    if any(column.heading for column in columns):
        cells.insert(0, [column.heading for column in columns])
    grid = Table(box=None, show_header=False, pad_edge=False, padding=(0, _GAP, 0, 0))
    widths = _widths(columns, cells)
    for column, width in zip(columns, widths, strict=True):
        side: Literal["left", "right"] = "right" if column.right else "left"
        overflow: Literal["ellipsis", "fold"] = "ellipsis" if column.fit == "cut" else "fold"
        grid.add_column(width=width, justify=side, no_wrap=column.fit != "wrap", overflow=overflow)
    for row in cells:
        grid.add_row(*map(Text, row))
    paper = Console(file=StringIO(), color_system=None, width=sum(widths) + _GAP * len(widths))
    with paper.capture() as printed:
        paper.print(grid)
    return "\n".join(line.rstrip() for line in printed.get().splitlines())


def facts(named: Iterable[tuple[str, str]]) -> str:
    """A line a fact, those that are empty left out."""
    return table((Column(""), Column("", "wrap")), [(name, text) for name, text in named if text])


def minute(at: datetime) -> str:
    """A time, as this machine's clock shows it."""
    return f"{at.astimezone():%Y-%m-%d %H:%M}"


def day(at: datetime) -> str:
    """The day of a time."""
    return f"{at.astimezone():%Y-%m-%d}"


def size(count: float) -> str:
    """Bytes, as "3.2 MB"."""
    if count < 1000:
        return f"{count:.0f} B"
    power = 1
    while count / 1000**power >= 999.5 and power < len(_SIZES):
        power += 1
    return f"{count / 1000**power:.3g} {_SIZES[power - 1]}"


def point(values: Sequence[float]) -> str:
    """A place, as "(0.100, -2.000, 0.350)"."""
    return f"({', '.join(f'{value:.3f}' for value in values)})"


def _widths(columns: Sequence[Column], cells: Sequence[Sequence[str]]) -> list[int]:
    """Width of each column: its need, or for the widest an equal share."""
    widths = [max(cell_len(row[number]) for row in cells) for number in range(len(columns))]
    elastic = [number for number, column in enumerate(columns) if column.fit != "whole"]
    room = WIDTH - _GAP * (len(columns) - 1) - sum(w for n, w in enumerate(widths) if n not in elastic)
    for left, number in zip(range(len(elastic), 0, -1), sorted(elastic, key=widths.__getitem__), strict=True):
        widths[number] = min(widths[number], room // left)
        room -= widths[number]
    return widths
