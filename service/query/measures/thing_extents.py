"""Where a thing ends: its box for measuring, without Gaussians that lie off its surfaces, and how sure each side is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fastsplat.service.query.measures.locating import axes_of
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.things.solid_gaussians import solid_rows
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.scene.objects.boxes import BOX_TRIM, oriented_box
from fastsplat_contract.geometry.poses import Box, Pose, quaternion_of, rigid, vector3

F64 = NDArray[np.float64]
Rows = NDArray[np.int64]

_MOST = 20_000
"""Gaussians of a thing that are looked at, evenly over its rows."""
_NEIGHBORS = 12
_OFF = 4.0
"""Deviations of its neighbors from their own mean beyond which a Gaussian lies off the surface that they make."""
_THINNEST = 0.5
"""Of a surface's usual thickness, the least that counts: twelve neighbors may lie in one plane by chance."""
_LAYER = 2.5
"""Usual thicknesses that the outermost layer is thick: most of a flat end's noise, and less than a thin wall."""
_STILL_OFF = 0.001
"""Share of a thing's Gaussians beyond the layer at either end: what is off the surface beside its like is not found."""


@dataclass(frozen=True)
class ThingExtents:
    """A thing as it is measured."""

    rows: Rows  # int64 [K], K ≥ 1, ascending: its Gaussians without strays, at most 20,000
    box: Box  # upright as that of `oriented_box`, with each face in the middle of the outermost layer of Gaussians
    deviations: tuple[float, float, float]  # standard deviation of each side of the box, both ends together


def thing_extents(index: SceneIndex, thing_id: int) -> ThingExtents | None:
    """A thing or a part as it is measured; None for one that has no solid Gaussians.

    Of an end it is unsure how thick its Gaussians are there (the median over the layer), and by how much the end moves
    if 1.5 % of the Gaussians are left out beyond it, as for the box that is shown: half of that counts.
    """
    gaussians, rows = index.scene.gaussians, _solid_rows(index, thing_id)
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
    return ThingExtents(rows, box, (float(deviations[0]), float(deviations[1]), float(deviations[2])))


def side_deviations(index: SceneIndex, thing_id: int, box: Box) -> tuple[float, float, float] | None:
    """Standard deviation of each side of a thing's box, both ends together, found as those of `thing_extents`; None for
    a thing that has no solid Gaussians.
    """
    rows = _solid_rows(index, thing_id)
    if not len(rows):
        return None
    rows, thickness = without_strays(index.scene.gaussians, rows)
    pose = rigid(box.center.orientation, box.center.position)
    first, second, third = _sides(index, rows, thickness, pose[:3, 3], pose[:3, :3])[1].tolist()
    return first, second, third


def without_strays(gaussians: Gaussians, rows: Rows) -> tuple[Rows, float]:
    """The Gaussians `rows` [K] that lie on the surface their neighbors make, and how thick that usually is.

    The twelve nearest others of a Gaussian have a mean and a covariance; one that is farther from that mean than four
    of their deviations in its direction (Mahalanobis' distance) is a stray: above a surface, or beyond its edge.

    Returns:
        int64 [M], at least half of the rows, in order; the median over them of the least deviation of the neighbors.
    """
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


def _solid_rows(index: SceneIndex, thing_id: int) -> Rows:
    things = index.things
    rows = np.flatnonzero((things.owner == thing_id) | (things.part_owner == thing_id))
    rows = np.intersect1d(rows, solid_rows(index.scene.gaussians))
    return rows[:: -(-len(rows) // _MOST) or 1]


def _sides(index: SceneIndex, rows: Rows, thickness: float, middle: F64, axes: F64) -> tuple[F64, F64]:
    """Where the Gaussians `rows` end along each of `axes` [3, 3] (columns) from `middle` [3], float64 [3, 2]; and the
    deviations of their extents, float64 [3]."""
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
    """The lower end of places [K] along a line and its standard deviation, of Gaussians with deviations [K] there."""
    ordered = np.sort(along)
    outermost = ordered[int(_STILL_OFF * len(ordered))]
    layer = along <= outermost + _LAYER * thickness
    end = float(np.median(along[layer]))
    moved = float(ordered[int(BOX_TRIM * len(ordered))]) - end
    return end, float(np.hypot(np.median(spread[layer]), moved / 2))
