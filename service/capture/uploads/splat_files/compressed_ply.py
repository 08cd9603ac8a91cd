"""Reads SuperSplat's compressed PLY (PlayCanvas's layout).

Elements: `chunk` with float bounds of 256 Gaussians, `vertex` of four packed integers, optionally `sh` of bytes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.uploads.splat_files.rows import (
    F32,
    SH_OF_REST,
    Y00,
    SplatLimits,
    SplatRows,
    bad_splat,
    check_count,
    logits,
    smallest_three,
)
from fastsplat.service.common.ply_tables import ASCII, Element, PlyHeader, check_size, read_element

_CHUNK = 256
_BOUNDS = {
    "position": ("min_x", "min_y", "min_z", "max_x", "max_y", "max_z"),
    "scale": ("min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z"),
    "color": ("min_r", "min_g", "min_b", "max_r", "max_g", "max_b"),
}
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_SH_RANGE = 8.0  # coefficients lie in ±4

U32 = NDArray[np.uint32]


def is_compressed(header: PlyHeader) -> bool:
    """Detects the header of a compressed splat."""
    vertex = header.element("vertex")
    return vertex is not None and "packed_position" in (vertex.layout.names or ())


def read_compressed_ply(path: Path, name: str, header: PlyHeader, limits: SplatLimits) -> SplatRows:
    """Reads a compressed PLY; logits ±inf for bytes 0 and 255. Raises as `read_splat_file`."""
    vertex = _element(name, header, "vertex", _PACKED, "<u4")
    check_count(name, vertex.count, limits)
    if header.encoding == ASCII:
        raise bad_splat(name, "is compressed and ASCII, which nobody writes")
    chunks = _element(name, header, "chunk", (*_BOUNDS["position"], *_BOUNDS["scale"]), "<f4")
    if chunks.count != -(-vertex.count // _CHUNK):
        raise bad_splat(name, f"has {chunks.count} chunks for {vertex.count} Gaussians, expected one for {_CHUNK}")
    check_size(path, header, chunks)
    check_size(path, header, vertex)
    bounds = {group: np.empty((chunks.count, 6), np.float32) for group in _BOUNDS}
    colored = set(_BOUNDS["color"]).issubset(chunks.layout.names or ())
    bounds["color"][:] = (0, 0, 0, 1, 1, 1)
    for rows, table in read_element(path, header, chunks):
        for group, names in _BOUNDS.items():
            if group != "color" or colored:
                bounds[group][rows] = np.stack([table[column] for column in names], axis=1)
    count = vertex.count
    sh_count = _sh_count(path, name, header, count)
    result = SplatRows.empty(count, sh_count)
    for rows, table in read_element(path, header, vertex):
        chunk = np.arange(rows.start, rows.stop) // _CHUNK
        result.means[rows] = _between(bounds["position"][chunk], _unpack_11_10_11(table["packed_position"]))
        result.log_scales[rows] = _between(bounds["scale"][chunk], _unpack_11_10_11(table["packed_scale"]))
        turns = table["packed_rotation"]  # the highest bits locate the omitted component
        components = np.stack([_unit(turns >> shift, 10) for shift in (20, 10, 0)], axis=1) - 0.5
        result.quats[rows] = smallest_three((turns >> 30).astype(np.intp), components * np.float32(np.sqrt(2)))
        color = np.stack([_unit(table["packed_color"] >> shift, 8) for shift in (24, 16, 8)], axis=1)
        result.sh[rows, 0] = (_between(bounds["color"][chunk], color) - 0.5) / Y00
        result.logit_opacities[rows] = logits((table["packed_color"] & 255).astype(np.uint8))
    if sh_count > 1:
        _read_harmonics(path, header, result)
    return result


def _element(name: str, header: PlyHeader, element_name: str, properties: tuple[str, ...], kind: str) -> Element:
    element = header.element(element_name)
    if element is None:
        raise bad_splat(name, f"is a compressed splat without an element called {element_name}")
    for needed in properties:
        if needed not in (element.layout.names or ()) or element.layout[needed] != np.dtype(kind):
            raise bad_splat(name, f"has no {np.dtype(kind).name} property {needed} in its element {element_name}")
    return element


def _sh_count(path: Path, name: str, header: PlyHeader, count: int) -> int:
    element = header.element("sh")
    if element is None:
        return 1
    names = element.layout.names or ()
    if len(names) not in SH_OF_REST or len(names) == 0:
        raise bad_splat(name, f"has {len(names)} harmonics, expected {', '.join(map(str, list(SH_OF_REST)[1:]))}")
    check_size(path, header, element)
    if element.count != count:
        raise bad_splat(name, f"has harmonics of {element.count} Gaussians, and {count} Gaussians")
    _element(name, header, "sh", tuple(f"f_rest_{index}" for index in range(len(names))), "<u1")
    return SH_OF_REST[len(names)]


def _read_harmonics(path: Path, header: PlyHeader, result: SplatRows) -> None:
    element = header.element("sh")
    assert element is not None
    higher = result.sh.shape[1] - 1
    levels = (np.arange(256, dtype=np.float32) + 0.5) / 256
    levels[0], levels[255] = 0, 1  # the encoder truncates, so levels stand for their middle, except at the ends
    levels = (levels - 0.5) * _SH_RANGE
    for rows, table in read_element(path, header, element):
        for index in range(3 * higher):
            result.sh[rows, 1 + index % higher, index // higher] = levels[table[f"f_rest_{index}"]]


def _between(bounds: F32, share: F32) -> F32:
    """Interpolates bounds [K, 6] by shares [K, 3]; NaN where a bound is not finite."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(bounds[:, :3] * (1 - share) + bounds[:, 3:] * share)


def _unit(packed: NDArray[np.integer], bits: int) -> F32:
    top = (1 << bits) - 1
    return np.asarray((packed & top).astype(np.float32) / np.float32(top))


def _unpack_11_10_11(packed: U32) -> F32:
    return np.stack([_unit(packed >> 21, 11), _unit(packed >> 11, 10), _unit(packed, 11)], axis=1)
