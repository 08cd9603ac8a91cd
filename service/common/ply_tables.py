"""Reads PLY files (Turk 1994) as tables of scalar columns, in bounded chunks."""

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

Refuse = Callable[[str], InvalidInputError]
"""Builds the error for a defect in words that follow the file's name."""


Table = NDArray[np.void]
"""Rows of an element, a structured array with one field per property."""


@dataclass(frozen=True)
class Element:
    """An element of a header."""

    name: str  # e.g. "vertex"
    count: int  # rows
    layout: np.dtype[np.void]  # one field per property, in the file's order
    has_lists: bool = False  # if so, neither this element nor those after it can be read


@dataclass(frozen=True)
class PlyHeader:
    """Header of a PLY file."""

    encoding: str  # `LITTLE`, `BIG` or `ASCII`
    elements: tuple[Element, ...]  # in the file's order
    size: int  # in bytes; the data follow
    refuse: Refuse  # error for defects in the data

    def element(self, name: str) -> Element | None:
        return next((element for element in self.elements if element.name == name), None)


def read_header(head: bytes, refuse: Refuse, encodings: Sequence[str] = (LITTLE, BIG, ASCII)) -> PlyHeader:
    """Parses the header in the first `MAX_HEADER_BYTES` bytes of a file.

    Raises:
        InvalidInputError: missing or malformed, or not in one of `encodings`.
    """
    lines, size = _header_lines(head, refuse)
    if not lines or lines[0][:1] != ["format"] or len(lines[0]) != 3 or lines[0][1] not in encodings:
        stated = " ".join(lines[0][1:])[:60] if lines else ""
        raise refuse(f"has the format {stated!r}, expected {' or '.join(f'{encoding} 1.0' for encoding in encodings)}")
    order = ">" if lines[0][1] == BIG else "<"
    elements: list[tuple[str, int, list[tuple[str, str]], bool]] = []
    for words in lines[1:]:
        if words[0] == "element" and len(words) == 3 and _is_count(words[2]):
            if words[1] in {element[0] for element in elements}:
                raise refuse(f"has two elements called {words[1][:40]!r}")
            elements.append((words[1], int(words[2]), [], False))
        elif words[0] == "property" and elements and len(words) == 3 and words[1] in _TYPES:
            properties = elements[-1][2]
            if words[2] in {name for name, _ in properties}:
                raise refuse(f"has two properties called {words[2][:40]!r}")
            properties.append((words[2], order + _TYPES[words[1]]))
        elif words[0] == "property" and elements and len(words) == 5 and words[1] == "list":
            elements[-1] = (*elements[-1][:3], True)
        else:
            raise refuse(f"has the header line {' '.join(words)[:80]!r}")
    found = tuple(Element(name, count, np.dtype(layout), lists) for name, count, layout, lists in elements)
    return PlyHeader(lines[0][1], found, size, refuse)


def read_element(path: Path, header: PlyHeader, element: Element) -> Iterator[tuple[slice, Table]]:
    """Yields an element's rows in chunks with their positions; call `check_size` first.

    Raises:
        InvalidInputError: the file is too short, or text is not a number.
    """
    before = header.elements[: header.elements.index(element)]
    if header.encoding != ASCII:
        yield from _binary_rows(path, _begin(header, element), element)
        return
    with path.open("rb") as file:
        file.seek(header.size)
        for _ in range(sum(section.count for section in before)):
            _line(header, file)
        yield from _ascii_rows(header, file, element)


def check_size(path: Path, header: PlyHeader, element: Element) -> None:
    """Checks that the file is large enough for the rows before memory is allocated.

    Raises:
        InvalidInputError: a list in the element or before it, no properties, or a file that is too short.
    """
    before = header.elements[: header.elements.index(element)]
    listed = next((section.name for section in (*before, element) if section.has_lists), None)
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
    numbers = sum(section.count * max(1, len(section.layout.names or ())) for section in (*before, element))
    if size < header.size + 2 * numbers - 1:  # a digit and a blank each
        raise header.refuse(f"has {size} bytes, too few for the {numbers} numbers that its header announces")


def _begin(header: PlyHeader, element: Element) -> int:
    """Offset of an element's rows in a binary file."""
    before = header.elements[: header.elements.index(element)]
    return header.size + sum(section.count * section.layout.itemsize for section in before)


def _binary_rows(path: Path, begin: int, element: Element) -> Iterator[tuple[slice, Table]]:
    for start in range(0, element.count, _PIECE_ROWS):
        rows = min(_PIECE_ROWS, element.count - start)
        offset = begin + start * element.layout.itemsize
        # Read, not mapped: pages of a mapped file would count as this process's memory until it ends.
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
        with np.errstate(over="ignore", invalid="ignore"):  # float overflow becomes infinity, which callers handle
            for column, name in enumerate(names):
                table[name] = _held(numbers[:, column], element.layout[name])
        yield slice(start, start + rows), table


def _held(numbers: NDArray[np.float64], kind: np.dtype[np.generic]) -> NDArray[np.float64]:
    """Clips numbers to the range of an integer column; larger ones would wrap around."""
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
    """Splits the header into words per line, without comments, and returns its size."""
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
