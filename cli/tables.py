"""Formats tables of at most 80 columns, facts, numbers, sizes and times."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from datetime import datetime
from typing import Literal, NamedTuple

from rich.cells import cell_len

WIDTH = 80
"""Columns of a terminal that every table fits into."""
_GAP = "  "
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
    cells = [[_printable(text) for text in row] for row in rows]
    if not cells:
        return ""
    if any(column.heading for column in columns):
        cells.insert(0, [column.heading for column in columns])
    widths = _widths(columns, cells)
    lines = []
    for row in cells:
        fitted = [_fitted(text, width, column.fit) for text, width, column in zip(row, widths, columns, strict=True)]
        for number in range(max(map(len, fitted))):
            parts = (cell_lines[number] if number < len(cell_lines) else "" for cell_lines in fitted)
            placed = (_placed(part, width, column) for part, width, column in zip(parts, widths, columns, strict=True))
            lines.append(_GAP.join(placed).rstrip())
    return "\n".join(lines)


def facts(named: Iterable[tuple[str, str]]) -> str:
    """A line a fact, those that are empty left out."""
    return table((Column(""), Column("", "wrap")), [(name, text) for name, text in named if text])


def minute(at: datetime) -> str:
    """A time, as this machine's clock shows it."""
    return f"{at.astimezone():%Y-%m-%d %H:%M}"


def day(at: datetime) -> str:
    """The day of a time."""
    return f"{at.astimezone():%Y-%m-%d}"


def duration(seconds: float) -> str:
    """As "40 s", "12 min" or "3 h 5 min"."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"


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
    room = WIDTH - len(_GAP) * (len(columns) - 1) - sum(w for n, w in enumerate(widths) if n not in elastic)
    for left, number in zip(range(len(elastic), 0, -1), sorted(elastic, key=widths.__getitem__), strict=True):
        widths[number] = min(widths[number], room // left)
        room -= widths[number]
    return widths


def _fitted(text: str, width: int, fit: Literal["whole", "cut", "wrap"]) -> list[str]:
    if cell_len(text) <= width or fit == "whole":
        return [text]
    if fit == "cut":
        return [_beginning(text, width - 1) + "…"]
    lines = [""]
    for word in text.split(" "):
        if lines[-1] and cell_len(lines[-1]) + 1 + cell_len(word) <= width:
            lines[-1] += f" {word}"
            continue
        if lines[-1]:
            lines.append("")
        while cell_len(word) > width:
            lines[-1] = _beginning(word, width)
            word = word[len(lines[-1]) :]
            lines.append("")
        lines[-1] = word
    return [line for line in lines if line]


def _beginning(text: str, width: int) -> str:
    """As many letters as fit, at least one."""
    low = 0
    while low < len(text) and cell_len(text[: low + 1]) <= width:
        low += 1
    return text[: max(1, low)]


def _placed(text: str, width: int, column: Column) -> str:
    room = " " * (width - cell_len(text))
    return room + text if column.right else text + room


def _printable(text: str) -> str:
    """Without what would move the cursor or color the terminal: names are typed by anybody."""
    return "".join(letter if letter.isprintable() else "?" for letter in re.sub(r"\s", " ", text))
