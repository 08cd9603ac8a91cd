"""The plain 3DGS PLY of Kerbl et al. 2023, as gsplat, nerfstudio, Postshot, SuperSplat and others write it.

All of them store what was optimized: opacities as logits, scales as natural logarithms, quaternions w x y z of any
length, and f_rest channel by channel (all red coefficients, then green, then blue).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fastsplat.service.capture.uploads.splat_files.limits import SplatLimits, bad_splat, check_count
from fastsplat.service.capture.uploads.splat_files.ply_tables import PlyHeader, Table, check_size, read_element
from fastsplat.service.capture.uploads.splat_files.rows import F32, SH_OF_REST, Y00, SplatRows

_MEANS, _QUATS = ("x", "y", "z"), ("rot_0", "rot_1", "rot_2", "rot_3")
_SCALES, _DC, _RGB = ("scale_0", "scale_1", "scale_2"), ("f_dc_0", "f_dc_1", "f_dc_2"), ("red", "green", "blue")


def read_splat_ply(path: Path, name: str, header: PlyHeader, limits: SplatLimits) -> SplatRows:
    """The Gaussians of a plain 3DGS PLY, in the file's order, numbers as they stand there.

    Properties may come in any order and scalar type; unknown ones are ignored. Where nerfstudio wrote colors as bytes
    (red, green, blue in place of f_dc), they become the constant coefficient: (color − 0.5) / Y_00.

    Raises:
        InvalidInputError: a property that every Gaussian needs is missing, or the file is too short.
        LimitExceededError: more Gaussians than the limit.
    """
    vertex = header.element("vertex")
    if vertex is None:
        raise bad_splat(name, "has no element called vertex")
    check_count(name, vertex.count, limits)
    present = set(vertex.layout.names or ())
    rest = sum(own.startswith("f_rest_") for own in present)
    if rest not in SH_OF_REST:
        raise bad_splat(name, f"has {rest} f_rest properties, expected {', '.join(map(str, SH_OF_REST))}")
    rest_names = tuple(f"f_rest_{index}" for index in range(rest))
    colors: tuple[str, ...] = _RGB if not present.intersection(_DC) and present.issuperset(_RGB) else _DC
    for own in (*_MEANS, *colors, *rest_names, "opacity", *_SCALES, *_QUATS):
        if own not in present:
            raise bad_splat(name, f"has no property {own}, which every Gaussian needs")
    count, sh_count = vertex.count, SH_OF_REST[rest]
    check_size(path, name, header, vertex)
    result = SplatRows.empty(count, sh_count)
    for rows, table in read_element(path, name, header, vertex):
        _fill(result.means[rows], table, _MEANS)
        _fill(result.quats[rows], table, _QUATS)
        _fill(result.log_scales[rows], table, _SCALES)
        _fill(result.logit_opacities[rows, None], table, ("opacity",))
        _fill(result.sh[rows, 0], table, colors)
        if colors == _RGB:
            whole = 255.0 if vertex.layout["red"].kind in "iu" else 1.0
            result.sh[rows, 0] = (result.sh[rows, 0] / whole - 0.5) / Y00
        for channel in range(3):
            begin = channel * (sh_count - 1)
            _fill(result.sh[rows, 1:, channel], table, rest_names[begin : begin + sh_count - 1])
    return result


def _fill(out: F32, table: Table, names: tuple[str, ...]) -> None:
    with np.errstate(over="ignore", invalid="ignore"):  # a double that no float can hold becomes infinite
        for column, own in enumerate(names):
            out[:, column] = table[own]
