"""Reads colored points from PLY files, as nerfstudio stores them beside its poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.common.ply_tables import MAX_HEADER_BYTES, check_size, read_element, read_header
from fastsplat_contract.errors import InvalidInputError, LimitExceededError

_COLOR = ("red", "green", "blue")


def read_points(path: Path, name: str, settings: CaptureSettings) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Reads positions, float32 [P, 3], and colors, uint8 [P, 3], mid gray if absent.

    Raises:
        InvalidInputError: not a PLY file, no `vertex` element with x, y, z, fewer rows than it claims, NaN.
        LimitExceededError: more than `max_model_points` rows; checked in the header.
    """

    def refuse(problem: str) -> InvalidInputError:
        hint = "Send points as a PLY file with x, y, z and colors."
        return InvalidInputError(f"{name} {problem}", field=name, hint=hint)

    with path.open("rb") as file:
        header = read_header(file.read(MAX_HEADER_BYTES), refuse)
    vertices = header.element("vertex")
    if vertices is None or not {"x", "y", "z"}.issubset(vertices.layout.names or ()):
        raise refuse("has no vertices with x, y, z")
    if vertices.count > settings.max_model_points:
        raise too_many_points(name, vertices.count, settings)
    check_size(path, header, vertices)
    points = np.empty((vertices.count, 3), np.float32)
    colors = np.full((vertices.count, 3), 128, np.uint8)
    colored = set(_COLOR).issubset(vertices.layout.names or ())
    for rows, table in read_element(path, header, vertices):
        with np.errstate(over="ignore"):
            points[rows] = np.stack([table[axis] for axis in "xyz"], axis=1)
        if colored:
            channels = np.stack([table[channel] for channel in _COLOR], axis=1)
            whole = 255 if channels.dtype.kind == "f" else 1  # by convention, floats are 0..1
            colors[rows] = np.clip(np.nan_to_num(channels * whole), 0, 255)
    if not np.isfinite(points).all():
        raise refuse("has NaN or infinite positions")
    return points, colors


def too_many_points(name: str, count: int, settings: CaptureSettings) -> LimitExceededError:
    """Makes the error of a file with too many points."""
    return LimitExceededError.of(name, f"has {count} points", "Send fewer.", f"{settings.max_model_points} points")
