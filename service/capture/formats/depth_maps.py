"""Stores a capture's depth maps as scaled 16-bit PNGs and resamples them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.captures import SensorDepth
from fastsplat_contract.geometry.camera import Camera

DEPTHS = "depths"  # folder in a capture
_STEPS = 65_535
_NEARLY_ALL, _FAR = 0.99, 4.0
_EDGE = 0.04
"""Relative depth difference of neighbors that marks an edge, where sensors mix surfaces."""

F32 = NDArray[np.float32]


def save_depth(depth: F32, camera: Camera, path: Path) -> SensorDepth:
    """Writes a map as a 16-bit PNG.

    A few pixels several times farther than nearly all others become unknown, as they would coarsen every step.
    """
    known = depth[depth > 0]
    farthest = float(min(known.max(), _FAR * np.quantile(known, _NEARLY_ALL))) if len(known) else 0.0
    unit = farthest / _STEPS or 1.0
    steps = np.where(depth <= farthest, np.round(depth / unit), 0)
    Image.fromarray(steps.astype(np.uint16)).save(path, compress_level=1)
    return SensorDepth(path, camera, unit)


def load_depth(sensor: SensorDepth) -> F32:
    """Loads a map, float32 [H, W], scene units, 0 where unknown."""
    with Image.open(sensor.path) as image:
        return np.asarray(image).astype(np.float32) * np.float32(sensor.unit)


def resample_depth(depth: F32, source: Camera, target: Camera) -> F32:
    """Resamples a map, 0 where unknown, for another camera at its place, without interpolation."""
    finer = source.fx >= target.fx
    at, of = (target, source) if finer else (source, target)
    columns = np.floor((np.arange(at.width) + 0.5 - at.cx) / at.fx * of.fx + of.cx).astype(np.int64)
    rows = np.floor((np.arange(at.height) + 0.5 - at.cy) / at.fy * of.fy + of.cy).astype(np.int64)
    inside_x = np.flatnonzero((columns >= 0) & (columns < of.width))
    inside_y = np.flatnonzero((rows >= 0) & (rows < of.height))
    result = np.zeros((target.height, target.width), np.float32)
    here, there = np.ix_(inside_y, inside_x), np.ix_(rows[inside_y], columns[inside_x])
    if finer:
        result[here] = depth[there]
    else:
        result[there] = depth[here]
    return result


def inner_pixels(depth: F32) -> NDArray[np.bool_]:
    """Masks pixels whose depth is nearly that of all four neighbors, bool [H, W]."""
    inner = np.zeros(depth.shape, bool)
    here = depth[1:-1, 1:-1]
    alike = here > 0
    for neighbor in (depth[:-2, 1:-1], depth[2:, 1:-1], depth[1:-1, :-2], depth[1:-1, 2:]):
        alike &= np.abs(neighbor - here) <= _EDGE * here
    inner[1:-1, 1:-1] = alike
    return inner
