"""Measured extents of an object: its box without stray Gaussians, and each side's deviation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fastsplat.service.query.measures.locating import axes_of
from fastsplat.service.query.objects.solid_gaussians import solid_rows
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.scene.objects.boxes import BOX_TRIM, oriented_box
from fastsplat_contract.geometry.poses import Box, Pose, quaternion_of, rigid, vector3

F64 = NDArray[np.float64]
Rows = NDArray[np.int64]

_MOST = 20_000
"""Most Gaussians of an object that are used, evenly over its rows."""
_NEIGHBORS = 12
_OFF = 4.0
"""Mahalanobis distance to its neighbors beyond which a Gaussian is a stray."""
_THINNEST = 0.5
"""Least surface thickness relative to the usual: neighbors may be coplanar by chance."""
_LAYER = 2.5
"""Usual thicknesses in the outermost layer: more than noise, less than a wall."""
_STILL_OFF = 0.001
"""Share of Gaussians ignored at either end: strays that lie together are not detected."""


@dataclass(frozen=True)
class ObjectExtents:
    """Measured extents of an object."""

    rows: Rows  # int64 [K], K ≥ 1, ascending: its Gaussians without strays, at most 20,000
    box: Box  # upright as that of `oriented_box`, with each face in the middle of the outermost layer of Gaussians
    deviations: tuple[float, float, float]  # standard deviation of each side of the box, both ends together


def object_extents(index: SceneIndex, object_id: int) -> ObjectExtents | None:
    """Measures an object or a part; None without solid Gaussians.

    The deviation of an end combines the thickness of its Gaussians (median over the layer) and half of the shift if 1.5
    % of the Gaussians are trimmed, as in the displayed box."""
    gaussians, rows = index.scene.gaussians, _solid_rows(index, object_id)
    if not len(rows):
        return None
    rows, thickness = without_strays(gaussians, rows)
    means = gaussians.means[rows].astype(np.float64)
    outline = oriented_box(means, np.ones(len(rows)), index.scene.up())
    pose = rigid(outline.center.orientation, outline.center.position)
    axes, middle = pose[:3, :3], pose[:3, 3]
    ends, deviations = _sides(index, rows, thickness, middle, axes)
    size = ends[:, 1] - ends[:, 0]
    if size[0] < size[1]:  # the x axis of a box is the longer one
        axes = np.stack([axes[:, 1], -axes[:, 0], axes[:, 2]], axis=1)
        ends = np.stack([ends[1], -ends[0][::-1], ends[2]])
        size, deviations = size[[1, 0, 2]], deviations[[1, 0, 2]]
    center = middle + axes @ ends.mean(axis=1)
    box = Box(Pose(vector3(center), quaternion_of(axes)), vector3(size))
    return ObjectExtents(rows, box, (float(deviations[0]), float(deviations[1]), float(deviations[2])))


def side_deviations(index: SceneIndex, object_id: int, box: Box) -> tuple[float, float, float] | None:
    """Deviations of a box's sides, as in `object_extents`; None without solid Gaussians."""
    rows = _solid_rows(index, object_id)
    if not len(rows):
        return None
    rows, thickness = without_strays(index.scene.gaussians, rows)
    pose = rigid(box.center.orientation, box.center.position)
    first, second, third = _sides(index, rows, thickness, pose[:3, 3], pose[:3, :3])[1].tolist()
    return first, second, third


def without_strays(gaussians: Gaussians, rows: Rows) -> tuple[Rows, float]:
    """Removes Gaussians off their neighbors' surface; returns int64 [M] and its thickness.

    A stray is more than four Mahalanobis distances from its twelve nearest neighbors; at least half of the rows stay.
    The thickness is the median of the neighbors' least deviation."""
    if len(rows) <= 2 * _NEIGHBORS:
        return rows, 0.0
    means = gaussians.means[rows].astype(np.float64)
    near = means[cKDTree(means).query(means, k=_NEIGHBORS + 1)[1][:, 1:]]
    middles = near.mean(axis=1)
    offsets = near - middles[:, None]
    variances, directions = np.linalg.eigh(np.einsum("kni,knj->kij", offsets, offsets) / _NEIGHBORS)
    variances = np.maximum(variances, 0.0)
    thickness = float(np.sqrt(np.median(variances[:, 0])))
    floor = max((_THINNEST * thickness) ** 2, np.finfo(np.float64).tiny)
    away = np.einsum("ki,kij->kj", means - middles, directions)
    distance = np.sqrt((away**2 / np.maximum(variances, floor)).sum(axis=1))
    on = distance <= max(_OFF, float(np.median(distance)))
    return rows[on], thickness


def _solid_rows(index: SceneIndex, object_id: int) -> Rows:
    objects = index.objects
    rows = np.flatnonzero((objects.owner == object_id) | (objects.part_owner == object_id))
    rows = np.intersect1d(rows, solid_rows(index.scene.gaussians))
    return rows[:: -(-len(rows) // _MOST) or 1]


def _sides(index: SceneIndex, rows: Rows, thickness: float, middle: F64, axes: F64) -> tuple[F64, F64]:
    """Ends along each of `axes` (columns) from `middle`, [3, 2], and side deviations [3]."""
    along = (index.scene.gaussians.means[rows].astype(np.float64) - middle) @ axes
    turns, widths = axes_of(index, rows)
    ends, deviations = np.zeros((3, 2)), np.zeros(3)
    for side in range(3):
        spread = np.sqrt(((np.einsum("kji,j->ki", turns, axes[:, side]) * widths) ** 2).sum(axis=1))
        low, low_deviation = _end(along[:, side], spread, thickness)
        high, high_deviation = _end(-along[:, side], spread, thickness)
        ends[side] = low, -high
        deviations[side] = np.hypot(low_deviation, high_deviation)
    return ends, deviations


def _end(along: F64, spread: F64, thickness: float) -> tuple[float, float]:
    """Lower end of positions [K] with deviations [K] on a line, and its deviation."""
    ordered = np.sort(along)
    outermost = ordered[int(_STILL_OFF * len(ordered))]
    layer = along <= outermost + _LAYER * thickness
    end = float(np.median(along[layer]))
    moved = float(ordered[int(BOX_TRIM * len(ordered))]) - end
    return end, float(np.hypot(np.median(spread[layer]), moved / 2))
