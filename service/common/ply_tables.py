"""PLY files as tables of scalar columns, read in pieces of bounded size (Turk 1994, the PLY polygon file format)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from fastsplat_contract.errors import InvalidInputError

MAX_HEADER_BYTES = 64 << 10
_MAX_LINE_BYTES = 64 << 10
_PIECE_ROWS = 1 << 16
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
LITTLE, BIG, ASCII = "binary_little_endian", "binary_big_endian", "ascii"
"""What a header may say of how its data are written."""

Refuse = Callable[[str], InvalidInputError]
"""The error for what is wrong with a file, in the words behind its name: "is not a PLY file"."""


Table = NDArray[np.void]
"""Rows of an element, a structured array with one field a property."""


@dataclass(frozen=True)
class Element:
    """One element of a header.

    Attributes:
        name: of the element, e.g. "vertex".
        count: its rows.
        layout: one field a property, in the file's order.
        has_lists: whether a property is a list; such an element is not read, nor what lies behind it.
    """

    name: str
    count: int
    layout: np.dtype[np.void]
    has_lists: bool = False


@dataclass(frozen=True)
class PlyHeader:
    """What stands before the data of a PLY file.

    Attributes:
        encoding: of the data: `LITTLE`, `BIG` or `ASCII`.
        elements: in the file's order.
        size: bytes of the header; the data begin behind them.
        refuse: the error for what is wrong behind it.
    """

    encoding: str
    elements: tuple[Element, ...]
    size: int
    refuse: Refuse

    def element(self, name: str) -> Element | None:
        """The element of that name, or None."""
        return next((element for element in self.elements if element.name == name), None)


def read_header(head: bytes, refuse: Refuse, encodings: Sequence[str] = (LITTLE, BIG, ASCII)) -> PlyHeader:
    """The header in the first `MAX_HEADER_BYTES` bytes of a file.

    Args:
        head: these bytes.
        encodings: those that are read of it.

    Raises:
        InvalidInputError: none is there, or it cannot be read; it names the line.
    """
    lines, size = _header_lines(head, refuse)
    if not lines or lines[0][:1] != ["format"] or len(lines[0]) != 3 or lines[0][1] not in encodings:
        stated = " ".join(lines[0][1:])[:60] if lines else ""
        raise refuse(f"has the format {stated!r}, expected {' or '.join(f'{each} 1.0' for each in encodings)}")
    order = ">" if lines[0][1] == BIG else "<"
    elements: list[tuple[str, int, list[tuple[str, str]], bool]] = []
    for words in lines[1:]:
        if words[0] == "element" and len(words) == 3 and _is_count(words[2]):
            if words[1] in {element[0] for element in elements}:
                raise refuse(f"has two elements called {words[1][:40]!r}")
            elements.append((words[1], int(words[2]), [], False))
        elif words[0] == "property" and elements and len(words) == 3 and words[1] in _TYPES:
            properties = elements[-1][2]
            if words[2] in {own for own, _ in properties}:
                raise refuse(f"has two properties called {words[2][:40]!r}")
            properties.append((words[2], order + _TYPES[words[1]]))
        elif words[0] == "property" and elements and len(words) == 5 and words[1] == "list":
            elements[-1] = (*elements[-1][:3], True)
        else:
            raise refuse(f"has the header line {' '.join(words)[:80]!r}")
    found = tuple(Element(own, count, np.dtype(layout), lists) for own, count, layout, lists in elements)
    return PlyHeader(lines[0][1], found, size, refuse)


def read_element(path: Path, header: PlyHeader, element: Element) -> Iterator[tuple[slice, Table]]:
    """The rows of one element in pieces, each with its place among them; call `check_size` before.

    Raises:
        InvalidInputError: the file is too short, or text is no number.
    """
    before = header.elements[: header.elements.index(element)]
    if header.encoding != ASCII:
        yield from _binary_rows(path, _begin(header, element), element)
        return
    with path.open("rb") as file:
        file.seek(header.size)
        for _ in range(sum(own.count for own in before)):
            _line(header, file)
        yield from _ascii_rows(header, file, element)


def check_size(path: Path, header: PlyHeader, element: Element) -> None:
    """Raise unless the file's size vouches for all rows up to the element's last, before memory is taken for them.

    Raises:
        InvalidInputError: a list stands in the element or before it, it has no properties, or the file is too short.
    """
    before = header.elements[: header.elements.index(element)]
    listed = next((own.name for own in (*before, element) if own.has_lists), None)
    if listed is not None:
        raise header.refuse(f"has a list in its element {listed[:40]!r}, which is not read")
    if not element.layout.names:
        raise header.refuse(f"has no properties in its element {element.name[:40]!r}")
    size = path.stat().st_size
    if header.encoding != ASCII:
        end = _begin(header, element) + element.count * element.layout.itemsize
        if size < end:
            raise header.refuse(f"has {size} bytes where its header asks for at least {end}")
        return
    numbers = sum(own.count * max(1, len(own.layout.names or ())) for own in (*before, element))
    if size < header.size + 2 * numbers - 1:  # a digit and a blank each
        raise header.refuse(f"has {size} bytes, too few for the {numbers} numbers that its header announces")


def _begin(header: PlyHeader, element: Element) -> int:
    """Where the rows of an element begin in a binary file."""
    before = header.elements[: header.elements.index(element)]
    return header.size + sum(own.count * own.layout.itemsize for own in before)


def _binary_rows(path: Path, begin: int, element: Element) -> Iterator[tuple[slice, Table]]:
    for start in range(0, element.count, _PIECE_ROWS):
        rows = min(_PIECE_ROWS, element.count - start)
        offset = begin + start * element.layout.itemsize
        # Read, not mapped: the pages of a mapped file would count as this process's memory until its end.
        yield slice(start, start + rows), np.fromfile(path, element.layout, rows, offset=offset)


def _ascii_rows(header: PlyHeader, file: BinaryIO, element: Element) -> Iterator[tuple[slice, Table]]:
    names: Sequence[str] = element.layout.names or ()
    for start in range(0, element.count, _PIECE_ROWS // 8):
        rows = min(_PIECE_ROWS // 8, element.count - start)
        lines = [_line(header, file).split() for _ in range(rows)]
        wrong = next((row for row, words in enumerate(lines) if len(words) != len(names)), None)
        if wrong is not None:
            raise header.refuse(f"has {len(lines[wrong])} numbers in row {start + wrong}, expected {len(names)}")
        try:
            numbers = np.array(lines, dtype=np.float64)
        except ValueError as error:
            raise header.refuse(f"has text that is no number near row {start}: {str(error)[:80]}") from error
        table = np.empty(rows, element.layout)
        with np.errstate(over="ignore", invalid="ignore"):  # what a float cannot hold becomes infinite, and is handled
            for column, own in enumerate(names):
                table[own] = _held(numbers[:, column], element.layout[own])
        yield slice(start, start + rows), table


def _held(numbers: NDArray[np.float64], kind: np.dtype[np.generic]) -> NDArray[np.float64]:
    """Numbers as a column of that type holds them: integers that are too large for it would be others."""
    if kind.kind == "f":
        return numbers
    bounds = np.iinfo(kind.str)
    return np.clip(np.nan_to_num(numbers), bounds.min, bounds.max)


def _line(header: PlyHeader, file: BinaryIO) -> bytes:
    line = file.readline(_MAX_LINE_BYTES)
    if not line:
        raise header.refuse("ends before the rows that its header announces")
    if len(line) == _MAX_LINE_BYTES:
        raise header.refuse(f"has a line of more than {_MAX_LINE_BYTES} bytes")
    return line


def _header_lines(head: bytes, refuse: Refuse) -> tuple[list[list[str]], int]:
    """The words of every line behind "ply", comments left out, and the header's size in bytes."""
    if not head.startswith((b"ply\n", b"ply\r\n")):
        raise refuse("is not a PLY file")
    size = 0
    lines: list[list[str]] = []
    for raw in islice(head.splitlines(keepends=True), MAX_HEADER_BYTES):
        size += len(raw)
        if not raw.endswith(b"\n"):
            break
        try:
            words = raw.decode("ascii").split()
        except UnicodeDecodeError as error:
            if raw.startswith((b"comment", b"obj_info")):
                continue
            raise refuse("has a header that is not ASCII") from error
        if words == ["end_header"]:
            return lines[1:], size
        if words and words[0] not in ("comment", "obj_info"):
            lines.append(words)
    raise refuse(f"has no end of its PLY header within its first {MAX_HEADER_BYTES} bytes")


def _is_count(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= 18
