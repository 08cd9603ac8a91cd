"""Reads colored points from a PLY file, as nerfstudio keeps them beside its poses."""

from __future__ import annotations

import io
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.settings import CaptureSettings
from fastsplat_contract.errors import InvalidInputError, LimitExceededError

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_MAX_HEADER_BYTES = 1 << 16


def read_points(path: Path, name: str, settings: CaptureSettings) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """float32 [P, 3] positions and uint8 [P, 3] colors (mid gray where the file has none) of its first element.

    Raises:
        InvalidInputError: not a PLY file, no `vertex` element with x, y, z in front, fewer rows than it claims, NaN.
        LimitExceededError: more than `max_model_points` rows; read from the header.
    """
    with path.open("rb") as file:
        form, rows, fields = _header(file, name)
        if rows > settings.max_model_points:
            raise LimitExceededError(
                f"{name} claims {rows} points",
                field=name,
                limit=f"{settings.max_model_points} points",
                hint="Send a sparse model.",
            )
        columns = _ascii(file, rows, fields, name) if form == "ascii" else _binary(file, rows, fields, form, name)
    try:
        points = np.stack([columns[axis] for axis in "xyz"], axis=1).astype(np.float32)
    except KeyError as error:
        raise _bad(name, "has no x, y, z") from error
    if not np.isfinite(points).all():
        raise _bad(name, "has NaN or infinite positions")
    if not all(channel in columns for channel in ("red", "green", "blue")):
        return points, np.full((rows, 3), 128, np.uint8)
    colors = np.stack([columns[channel] for channel in ("red", "green", "blue")], axis=1)
    if dict(fields)["red"].startswith("f"):
        colors = colors * 255  # floats are 0..1, by custom
    return points, np.clip(np.nan_to_num(colors), 0, 255).astype(np.uint8)


def _header(file: BinaryIO, name: str) -> tuple[str, int, list[tuple[str, str]]]:
    lines = []
    while True:
        line = file.readline(_MAX_HEADER_BYTES)
        lines.append(line.decode("ascii", "replace").strip())
        if lines[0] != "ply" or not line or file.tell() > _MAX_HEADER_BYTES:
            raise _bad(name, "is not a PLY file")
        if lines[-1] == "end_header":
            break
    fields: list[tuple[str, str]] = []
    form, rows, elements = "", -1, 0
    for words in (line.split() for line in lines):
        if words[:1] == ["format"] and len(words) == 3:
            form = words[1]
        elif words[:1] == ["element"] and len(words) == 3:
            elements += 1
            if elements == 1:
                if words[1] != "vertex" or not words[2].isascii() or not words[2].isdigit() or len(words[2]) > 18:
                    raise _bad(name, "does not begin with vertices")
                rows = int(words[2])
        elif words[:1] == ["property"] and elements == 1:
            if len(words) != 3 or words[1] not in _TYPES or words[2] in dict(fields):
                raise _bad(name, f"has the property {' '.join(words[1:])[:60]!r}")
            fields.append((words[2], _TYPES[words[1]]))
    if form not in ("ascii", "binary_little_endian", "binary_big_endian") or rows < 0 or not fields:
        raise _bad(name, "has no usable header")
    return form, rows, fields


def _binary(
    file: BinaryIO, rows: int, fields: list[tuple[str, str]], form: str, name: str
) -> dict[str, NDArray[np.float64]]:
    order = "<" if form == "binary_little_endian" else ">"
    row = np.dtype([(field, order + kind) for field, kind in fields])
    data = file.read(rows * row.itemsize)
    if len(data) < rows * row.itemsize:
        raise _bad(name, f"claims {rows} points, but is too short for them")
    table = np.frombuffer(data, dtype=row)
    return {field: table[field] for field, _ in fields}


def _ascii(file: BinaryIO, rows: int, fields: list[tuple[str, str]], name: str) -> dict[str, NDArray[np.float64]]:
    begin = file.tell()
    if rows * 2 * len(fields) > file.seek(0, io.SEEK_END) - begin + 1:
        raise _bad(name, f"claims {rows} points, but is too short for them")
    file.seek(begin)
    words = file.read().split(None, rows * len(fields))[: rows * len(fields)]
    if len(words) < rows * len(fields):
        raise _bad(name, f"claims {rows} points of {len(fields)} numbers, but has only {len(words)} numbers")
    try:
        table = np.array(words, dtype=np.float64).reshape(rows, len(fields))
    except ValueError as error:
        raise _bad(name, f"has a row that is not numbers: {error}") from error
    return {field: table[:, index] for index, (field, _) in enumerate(fields)}


def _bad(name: str, problem: str) -> InvalidInputError:
    return InvalidInputError(f"{name} {problem}", field=name, hint="Send points as a PLY file with x, y, z and colors.")
