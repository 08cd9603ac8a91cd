"""Gaussians as the PLY file that 3D Gaussian splatting viewers open (the layout of Kerbl et al. 2023's exporter)."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.types import F32, SH_COUNTS, Gaussians
from fastsplat_contract.errors import InvalidInputError, LimitExceededError

_MAX_HEADER_BYTES = 64 << 10
_CHUNK_ROWS = 1 << 16
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "<i2", "int16": "<i2", "ushort": "<u2",
    "uint16": "<u2", "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4", "float": "<f4", "float32": "<f4",
    "double": "<f8", "float64": "<f8",
}  # fmt: skip
_COUNT_OF_REST = {3 * (count - 1): count for count in SH_COUNTS}
"""Coefficients of a color by the number of f_rest properties."""


def write_ply(
    gaussians: Gaussians,
    path: Path,
    rows: NDArray[np.bool_] | NDArray[np.integer] | None = None,
    *,
    codes: bool = False,
) -> None:
    """Write a binary little-endian PLY, float32: x y z nx ny nz f_dc_* f_rest_* opacity scale_* rot_*.

    Normals are zero; f_rest is channel-major (all red coefficients, then green, then blue); opacity is the logit,
    scale the natural logarithm, rot is w x y z: values as trained, so the round trip is exact to the bit.

    Args:
        gaussians: all Gaussians of a scene.
        path: replaced as a whole, never half written.
        rows: bool [G] mask or ids of the Gaussians to write; they keep the scene's row order. None writes all.
        codes: append the semantic codes as code_0.. after the standard properties; viewers ignore or reject those.

    Raises:
        InvalidInputError: `rows` has the wrong length or names a Gaussian that is not there.
    """
    ids = _rows(rows, len(gaussians))
    names = _property_names(gaussians.sh.shape[1], gaussians.codes.shape[1] if codes else 0)
    beside = path.with_name(f".{path.name}.{secrets.token_hex(6)}.tmp")
    try:
        with beside.open("wb") as file:
            file.write(ply_header(len(ids), [("float", name) for name in names]))
            for start in range(0, len(ids), _CHUNK_ROWS):
                file.write(_table(gaussians, ids[start : start + _CHUNK_ROWS], codes).tobytes())
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def ply_header(rows: int, properties: Iterable[tuple[str, str]], comments: Iterable[str] = ()) -> bytes:
    """The header of a binary little-endian PLY of one element, vertex, up to its first row.

    Args:
        rows: how many vertices follow.
        properties: type and name of each, in their order.
        comments: lines of ASCII.
    """
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)]
    lines += [f"element vertex {rows}", *(f"property {kind} {name}" for kind, name in properties), "end_header", ""]
    return "\n".join(lines).encode("ascii")


def read_ply(path: Path, *, max_gaussians: int = 20_000_000) -> Gaussians:
    """Gaussians of a 3DGS PLY; properties may come in any order, unknown ones of a scalar type are skipped.

    code_0.. become the codes, else D = 0. Nothing is allocated before the file's size has vouched for its row count.

    Raises:
        InvalidInputError: not a whole binary little-endian 3DGS PLY, or numbers that are not finite.
        LimitExceededError: more than `max_gaussians` rows.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(_MAX_HEADER_BYTES)
    except OSError as error:
        raise _bad(path, f"cannot be read: {error}") from error
    count, layout, start = _parse_header(path, head)
    if count > max_gaussians:
        raise LimitExceededError(
            f"{path.name} announces {count} Gaussians", field=path.name, limit=f"{max_gaussians} Gaussians"
        )
    expected = start + count * layout.itemsize
    if size != expected:
        raise _bad(path, f"has {size} bytes where its header asks for {expected}")
    sh_count, code_count = _check_properties(path, layout)
    names = [name for name in _property_names(sh_count, code_count) if name not in ("nx", "ny", "nz")]
    values = np.empty((count, len(names)), dtype=np.float32)
    if count:
        table = np.memmap(path, dtype=layout, mode="r", offset=start, shape=(count,))
        for column, name in enumerate(names):
            values[:, column] = table[name]
            bad = np.flatnonzero(~np.isfinite(values[:, column]))
            if len(bad):
                raise _bad(path, f"has {values[bad[0], column]} as {name} of row {bad[0]}")
    rest = values[:, 6 : 3 + 3 * sh_count].reshape(count, 3, sh_count - 1).transpose(0, 2, 1)
    after = 3 + 3 * sh_count
    return Gaussians(
        means=values[:, :3].copy(),
        quats=values[:, after + 4 : after + 8].copy(),
        log_scales=values[:, after + 1 : after + 4].copy(),
        logit_opacities=values[:, after].copy(),
        sh=np.concatenate([values[:, None, 3:6], rest], axis=1),
        codes=values[:, after + 8 :].copy(),
    )


def _property_names(sh_count: int, code_count: int) -> list[str]:
    names = ["x", "y", "z", "nx", "ny", "nz"]
    names += [f"f_dc_{i}" for i in range(3)] + [f"f_rest_{i}" for i in range(3 * (sh_count - 1))]
    names += ["opacity"] + [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    return names + [f"code_{i}" for i in range(code_count)]


def _table(gaussians: Gaussians, rows: NDArray[np.intp], codes: bool) -> F32:
    """float32 [R, P], the columns in the order of `_property_names`."""
    count = len(rows)
    sh = gaussians.sh[rows]
    columns = [
        gaussians.means[rows],
        np.zeros((count, 3), dtype=np.float32),
        sh[:, 0],
        sh[:, 1:].transpose(0, 2, 1).reshape(count, 3 * (sh.shape[1] - 1)),
        gaussians.logit_opacities[rows, None],
        gaussians.log_scales[rows],
        gaussians.quats[rows],
    ]
    if codes:
        columns.append(gaussians.codes[rows])
    return np.concatenate(columns, axis=1).astype("<f4", copy=False)


def _rows(rows: NDArray[np.bool_] | NDArray[np.integer] | None, count: int) -> NDArray[np.intp]:
    if rows is None:
        return np.arange(count)
    if rows.dtype == np.bool_:
        if rows.shape != (count,):
            raise InvalidInputError(f"a mask of shape {rows.shape} for {count} Gaussians", field="rows")
        return np.flatnonzero(rows)
    ids = np.unique(rows)
    if len(ids) and (ids[0] < 0 or ids[-1] >= count):
        raise InvalidInputError(f"Gaussian ids {ids[0]}..{ids[-1]} of {count} Gaussians", field="rows")
    return ids.astype(np.intp)


def _parse_header(path: Path, head: bytes) -> tuple[int, np.dtype[np.void], int]:
    """Row count, row layout and offset of the first row."""
    end = head.find(b"end_header\n")
    ending = b"end_header\n"
    if end < 0:
        end, ending = head.find(b"end_header\r\n"), b"end_header\r\n"
    if not head.startswith((b"ply\n", b"ply\r\n")) or end < 0:
        raise _bad(path, f"has no PLY header within its first {_MAX_HEADER_BYTES} bytes")
    try:
        lines = [line.split() for line in head[:end].decode("ascii").splitlines()[1:]]
    except UnicodeDecodeError as error:
        raise _bad(path, "has a header that is not ASCII") from error
    lines = [words for words in lines if words and words[0] not in ("comment", "obj_info")]
    if not lines or lines[0] != ["format", "binary_little_endian", "1.0"]:
        raise _bad(
            path, f"has the format {' '.join(lines[0][1:]) if lines else ''!r}, expected binary_little_endian 1.0"
        )
    if len(lines) < 2 or lines[1][:2] != ["element", "vertex"] or len(lines[1]) != 3:
        raise _bad(path, "does not begin with one element named vertex")
    count = lines[1][2]
    if not count.isascii() or not count.isdigit() or len(count) > 18:
        raise _bad(path, f"announces {count[:40]!r} rows")
    properties: list[tuple[str, str]] = []
    for words in lines[2:]:
        if len(words) != 3 or words[0] != "property" or words[1] not in _TYPES:
            raise _bad(path, f"has the header line {' '.join(words)[:80]!r}; only scalar vertex properties are read")
        properties.append((words[2], _TYPES[words[1]]))
    if not properties or len({name for name, _ in properties}) != len(properties):
        raise _bad(path, "has no properties, or two of one name")
    return int(count), np.dtype(properties), end + len(ending)


def _check_properties(path: Path, layout: np.dtype[np.void]) -> tuple[int, int]:
    """K and D, once every property a Gaussian needs is there as float."""
    names = layout.names or ()
    rest = sum(name.startswith("f_rest_") for name in names)
    codes = sum(name.startswith("code_") for name in names)
    if rest not in _COUNT_OF_REST:
        raise _bad(path, f"has {rest} f_rest properties, expected {', '.join(map(str, _COUNT_OF_REST))}")
    for name in _property_names(_COUNT_OF_REST[rest], codes):
        if name in ("nx", "ny", "nz"):
            continue
        if name not in names or layout[name] != np.dtype("<f4"):
            raise _bad(path, f"has no float property {name}, which every Gaussian needs")
    return _COUNT_OF_REST[rest], codes


def _bad(path: Path, what: str) -> InvalidInputError:
    return InvalidInputError(
        f"{path.name} {what}", field=path.name, hint="Send a binary little-endian 3D Gaussian splatting PLY."
    )
