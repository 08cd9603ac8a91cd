"""Reads splat files of all formats as arrays in row order."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.uploads.splat_files.compressed_ply import is_compressed, read_compressed_ply
from fastsplat.service.capture.uploads.splat_files.plain_rows import read_ksplat, read_splat_rows
from fastsplat.service.capture.uploads.splat_files.rows import (
    F32,
    SH_OF_REST,
    Y00,
    SplatLimits,
    SplatRows,
    bad_splat,
    check_count,
)
from fastsplat.service.capture.uploads.splat_files.sog import is_sog, read_sog
from fastsplat.service.capture.uploads.splat_files.spz import read_spz
from fastsplat.service.common.ply_tables import (
    MAX_HEADER_BYTES,
    PlyHeader,
    Table,
    check_size,
    read_element,
    read_header,
)

_MEANS, _QUATS = ("x", "y", "z"), ("rot_0", "rot_1", "rot_2", "rot_3")
_SCALES, _DC, _RGB = ("scale_0", "scale_1", "scale_2"), ("f_dc_0", "f_dc_1", "f_dc_2"), ("red", "green", "blue")
PLY_SUFFIX = ".ply"
SplatFormat = Literal["3DGS PLY", "compressed PLY", "SPZ", "SOG", ".splat", ".ksplat"]
_BY_SUFFIX: Mapping[str, tuple[Callable[[Path, str, SplatLimits], SplatRows], SplatFormat]] = {
    ".spz": (read_spz, "SPZ"),
    ".sog": (read_sog, "SOG"),
    ".splat": (read_splat_rows, ".splat"),
    ".ksplat": (read_ksplat, ".ksplat"),
}

_MARKS = ((b" packed_position",), (b" scale_0", b" opacity"))
_OPAQUE_LOGIT = 16.0  # the logistic function of it is 1 but for 1e-7
_TELLING_ROWS = 16  # fewer may have any signs
_THINNEST = -30.0  # of the natural logarithm of a standard deviation
_WIDEST = 40.0  # its square is the largest that a float32 covariance can hold


@dataclass(frozen=True)
class SplatFile:
    """Content of a splat file."""

    rows: SplatRows  # all G in order; all numbers are finite
    format: SplatFormat
    invisible: int = 0  # rows with a non-finite number or a zero quaternion
    """They stay with opacity zero, so that the others keep their numbers."""
    first_invisible: int = -1  # row of the first


def is_splat_file(path: Path) -> bool:
    """Detects a splat by its name and, for PLY, by the properties in its header."""
    suffix = path.suffix.lower()
    if suffix != PLY_SUFFIX:
        return suffix in _BY_SUFFIX or (suffix == ".zip" and is_sog(path))
    with path.open("rb") as file:
        header, end, _ = file.read(MAX_HEADER_BYTES).partition(b"end_header")
    return bool(end) and header.startswith(b"ply") and any(all(mark in header for mark in marks) for marks in _MARKS)


def read_splat_file(path: Path, name: str, limits: SplatLimits) -> SplatFile:
    """Reads a splat file of any format; infinite logits become opacities of 0 and 1.

    Raises:
        InvalidInputError: not a whole splat file, or no row of it can be shown.
        LimitExceededError: more Gaussians than the limit.
    """
    suffix = ".sog" if path.suffix.lower() == ".zip" else path.suffix.lower()
    if suffix in _BY_SUFFIX:
        reader, form = _BY_SUFFIX[suffix]
        return _settled(name, reader(path, name, limits), form)
    with path.open("rb") as file:
        header = read_header(file.read(MAX_HEADER_BYTES), partial(bad_splat, name))
    if is_compressed(header):
        return _settled(name, read_compressed_ply(path, name, header, limits), "compressed PLY")
    return _settled(name, read_splat_ply(path, name, header, limits), "3DGS PLY")


def _settled(name: str, splat: SplatRows, form: SplatFormat) -> SplatFile:
    """Makes every number finite, in place."""
    logits, log_scales = splat.logit_opacities, splat.log_scales
    np.copyto(logits, np.copysign(np.float32(_OPAQUE_LOGIT), logits), where=np.isinf(logits))
    np.copyto(log_scales, np.float32(_THINNEST), where=log_scales == -np.inf)
    bad = ~_visible(splat)
    rows = np.flatnonzero(bad)
    if len(rows) == len(splat):
        raise bad_splat(name, f"has no row that can be shown; of row 0, {_first_problem(splat)}")
    if len(rows):
        splat.means[rows] = np.median(splat.means[~bad], axis=0)
        splat.quats[rows] = (1, 0, 0, 0)
        splat.log_scales[rows] = _THINNEST
        splat.logit_opacities[rows] = -_OPAQUE_LOGIT
        splat.sh[rows] = 0
    return SplatFile(splat, form, len(rows), int(rows[0]) if len(rows) else -1)


def _visible(splat: SplatRows) -> NDArray[np.bool_]:
    visible = np.isfinite(splat.means).all(axis=1) & np.isfinite(splat.logit_opacities)
    visible &= (splat.log_scales <= _WIDEST).all(axis=1)  # False of NaN, too
    visible &= np.isfinite(splat.quats).all(axis=1) & (splat.quats != 0).any(axis=1)
    visible &= np.isfinite(splat.sh).all(axis=(1, 2))
    return np.asarray(visible)


def _first_problem(splat: SplatRows) -> str:
    for field in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        if not np.isfinite(getattr(splat, field)[0]).all():
            return f"{field} are not finite"
    return "the quaternion is zero, or a scale beyond all measure"


def describe_invisible(name: str, file: SplatFile) -> tuple[str, ...]:
    """Makes a sentence for people about invisible rows, if any."""
    if not file.invisible:
        return ()
    return (
        f"{file.invisible} of {len(file.rows)} rows of {name} cannot be shown, the first of them row "
        f"{file.first_invisible}: numbers that are not finite, or a quaternion of length zero. They stay as invisible "
        "Gaussians, so that all rows keep their numbers.",
    )


def describe_numbers(name: str, file: SplatFile) -> tuple[str, ...]:
    """Makes sentences for people about columns whose signs contradict a 3DGS PLY."""
    rows, said = file.rows, []
    if file.format == "3DGS PLY" and len(rows) >= _TELLING_ROWS:
        low, high = float(rows.logit_opacities.min()), float(rows.logit_opacities.max())
        if low >= 0 and high <= 1:
            said.append(
                f"The opacity of {name} lies between {low:.3g} and {high:.3g}, as if it were no logit, of which some "
                "are negative; it is read as logits. Export it before activation."
            )
        if (rows.log_scales[:, :2] > 0).all():
            said.append(
                f"The columns scale_0 and scale_1 of {name} are all positive, as if they were no logarithms, of which "
                "most are negative; they are read as logarithms. Export them before activation."
            )
        if (rows.log_scales[:, 2] == _THINNEST).all():
            said.append(f"{name} has no scale_2, as 2D Gaussian splatting: its Gaussians are read as flat disks.")
    return tuple(said)


def read_splat_ply(path: Path, name: str, header: PlyHeader, limits: SplatLimits) -> SplatRows:
    """Reads a plain 3DGS PLY, unactivated; raises as `read_splat_file`.

    Properties may have any order and scalar type; unknown ones are ignored. Quaternions w x y z may have any length;
    f_rest is by channel. Byte colors (nerfstudio's red, green, blue) become f_dc: (color − 0.5) / Y_00.
    """
    vertex = header.element("vertex")
    if vertex is None:
        raise bad_splat(name, "has no element called vertex")
    check_count(name, vertex.count, limits)
    present = set(vertex.layout.names or ())
    rest = sum(column.startswith("f_rest_") for column in present)
    if rest not in SH_OF_REST:
        raise bad_splat(name, f"has {rest} f_rest properties, expected {', '.join(map(str, SH_OF_REST))}")
    rest_names = tuple(f"f_rest_{index}" for index in range(rest))
    colors: tuple[str, ...] = _RGB if not present.intersection(_DC) and present.issuperset(_RGB) else _DC
    scales = tuple(axis for axis in _SCALES if axis in present or axis != _SCALES[2])  # the splats of 2DGS are flat
    for column in (*_MEANS, *colors, *rest_names, "opacity", *scales, *_QUATS):
        if column not in present:
            raise bad_splat(name, f"has no property {column}, which every Gaussian needs")
    count, sh_count = vertex.count, SH_OF_REST[rest]
    check_size(path, header, vertex)
    result = SplatRows.empty(count, sh_count)
    for rows, table in read_element(path, header, vertex):
        _fill(result.means[rows], table, _MEANS)
        _fill(result.quats[rows], table, _QUATS)
        result.log_scales[rows, 2] = _THINNEST
        _fill(result.log_scales[rows], table, scales)
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
        for column, name in enumerate(names):
            out[:, column] = table[name]
