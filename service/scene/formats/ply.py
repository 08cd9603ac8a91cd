"""Reads and writes 3DGS PLY files (the layout of Kerbl et al. 2023's exporter)."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.ply_tables import LITTLE, MAX_HEADER_BYTES, check_size, read_element, read_header
from fastsplat.service.scene.artefact.scene import F32, SH_COUNTS, Gaussians
from fastsplat_contract.errors import InvalidInputError, LimitExceededError

_CHUNK_ROWS = 1 << 16
_COUNT_OF_REST = {3 * (count - 1): count for count in SH_COUNTS}
"""SH coefficients per channel by number of f_rest properties."""


def write_ply(gaussians: Gaussians, path: Path, rows: NDArray[np.bool_] | NDArray[np.integer] | None = None) -> None:
    """Writes a binary little-endian float32 PLY in the 3DGS layout.

    Normals are zero; f_rest is channel-major (all red, then green, then blue); opacity is the logit, scale the natural
    logarithm, rot is w x y z. Values are written as trained, so the round trip is bit-exact.

    Args:
        gaussians: all Gaussians of a scene.
        path: replaced atomically.
        rows: bool [G] mask or ids to write, in the scene's row order; None writes all.

    Raises:
        InvalidInputError: `rows` has the wrong length or unknown ids.
    """
    ids = _rows(rows, len(gaussians))
    names = _property_names(gaussians.sh.shape[1])
    beside = path.with_name(f".{path.name}.{secrets.token_hex(6)}.tmp")
    try:
        with beside.open("wb") as file:
            file.write(ply_header(len(ids), [("float", name) for name in names]))
            for start in range(0, len(ids), _CHUNK_ROWS):
                file.write(_table(gaussians, ids[start : start + _CHUNK_ROWS]).tobytes())
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def ply_header(rows: int, properties: Iterable[tuple[str, str]], comments: Iterable[str] = ()) -> bytes:
    """Builds the header of a binary little-endian PLY with only vertices."""
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)]
    lines += [f"element vertex {rows}", *(f"property {kind} {name}" for kind, name in properties), "end_header", ""]
    return "\n".join(lines).encode("ascii")


def read_ply(path: Path, *, max_gaussians: int = 20_000_000) -> Gaussians:
    """Reads a 3DGS PLY; the Gaussians have no codes.

    Properties may have any order; unknown scalar ones are skipped. Memory is allocated only after the file's size has
    confirmed its row count.

    Raises:
        InvalidInputError: not a complete binary little-endian 3DGS PLY, or non-finite numbers.
        LimitExceededError: more than `max_gaussians` rows.
    """
    refuse = partial(_bad, path)
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            header = read_header(file.read(MAX_HEADER_BYTES), refuse, (LITTLE,))
    except OSError as error:
        raise refuse(f"cannot be read: {error}") from error
    if [element.name for element in header.elements] != ["vertex"]:
        raise refuse("does not consist of one element named vertex")
    (vertices,) = header.elements
    count = vertices.count
    if count > max_gaussians:
        raise LimitExceededError(
            f"{path.name} announces {count} Gaussians", field=path.name, limit=f"{max_gaussians} Gaussians"
        )
    check_size(path, header, vertices)
    if size != (expected := header.size + count * vertices.layout.itemsize):
        raise refuse(f"has {size} bytes where its header asks for {expected}")
    sh_count = _check_properties(path, vertices.layout)
    names = [name for name in _property_names(sh_count) if name not in ("nx", "ny", "nz")]
    values = np.empty((count, len(names)), dtype=np.float32)
    for rows, table in read_element(path, header, vertices):
        for column, name in enumerate(names):
            values[rows, column] = table[name]
    for row, column in np.argwhere(~np.isfinite(values))[:1]:
        raise refuse(f"has {values[row, column]} as {names[column]} of row {row}")
    rest = values[:, 6 : 3 + 3 * sh_count].reshape(count, 3, sh_count - 1).transpose(0, 2, 1)
    after = 3 + 3 * sh_count
    return Gaussians(
        means=values[:, :3].copy(),
        quats=values[:, after + 4 : after + 8].copy(),
        log_scales=values[:, after + 1 : after + 4].copy(),
        logit_opacities=values[:, after].copy(),
        sh=np.concatenate([values[:, None, 3:6], rest], axis=1),
        codes=np.zeros((count, 0), np.float32),
    )


def _property_names(sh_count: int) -> list[str]:
    names = ["x", "y", "z", "nx", "ny", "nz"]
    names += [f"f_dc_{i}" for i in range(3)] + [f"f_rest_{i}" for i in range(3 * (sh_count - 1))]
    return [*names, "opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]


def _table(gaussians: Gaussians, rows: NDArray[np.intp]) -> F32:
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


def _check_properties(path: Path, layout: np.dtype[np.void]) -> int:
    """Checks the properties of a Gaussian; returns K."""
    names = layout.names or ()
    rest = sum(name.startswith("f_rest_") for name in names)
    if rest not in _COUNT_OF_REST:
        raise _bad(path, f"has {rest} f_rest properties, expected {', '.join(map(str, _COUNT_OF_REST))}")
    for name in _property_names(_COUNT_OF_REST[rest]):
        if name in ("nx", "ny", "nz"):
            continue
        if name not in names or layout[name] != np.dtype("<f4"):
            raise _bad(path, f"has no float property {name}, which every Gaussian needs")
    return _COUNT_OF_REST[rest]


def _bad(path: Path, what: str) -> InvalidInputError:
    return InvalidInputError.of(path.name, f"{what}", "Send a binary little-endian 3D Gaussian splatting PLY.")
