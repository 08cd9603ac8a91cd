"""Surfaces: flat objects, what lies in their planes, and their kind by gravity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.instances.discovery.candidates import F32, Candidate
from fastsplat.service.instances.discovery.ownership import NOBODY, STRAY_SHARE, Owners
from fastsplat.service.scene.artefact.scene import Gaussians, SurfaceKind
from fastsplat.service.scene.gaussians.connectivity import components

_SURFACE_SHARE = 0.015  # least share of the visible weight of a surface
_SURFACE_FLATNESS = 0.25  # largest tolerance of a surface's plane, as a share of its extent
_PIECE_INSIDE = 0.5  # objects in a surface's plane join it with at least this share inside its masks
_PIECE_SUPPORT = 0.45  # objects in a surface's plane with less support join it, too

F64 = NDArray[np.float64]

_TRIALS = 256
_REFITS = 4
_DEVIATIONS = 3.0
_MAD_TO_DEVIATION = 1.4826  # of a normal distribution
_LEVEL = 0.9
_UPRIGHT = 0.25
_SAMPLE = 4096
_CORE = 0.5  # share of an object's weight that must lie in a plane for the object to lie in it
_TIGHT = 0.5
_OFFSET = 0.3  # largest median offset of a piece, as a share of a plane's tolerance (0.9 standard deviations)


@dataclass(frozen=True)
class Plane:
    """The points x with normal · x = offset."""

    normal: F64  # [3], unit length, world frame
    offset: float  # scene units
    tolerance: float  # scene units, three standard deviations of the centers that it was fitted to

    def distance(self, points: NDArray[np.floating]) -> F64:
        """float64 [K] of points [K, 3], never negative."""
        return np.asarray(np.abs(points @ self.normal - self.offset))


def fit_plane(points: F64, weights: F64, *, seed: int = 0) -> Plane:
    """Fits a plane to weighted points [K, 3], K ≥ 3, robustly.

    Least median of squares over random triples (Rousseeuw 1984), then least squares over the points within the
    tolerance, which follows from the median absolute deviation.
    """
    rng = np.random.default_rng(seed)
    some = rng.choice(len(points), min(len(points), _SAMPLE), p=weights / weights.sum())
    triples = points[rng.choice(some, (_TRIALS, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > 0] / lengths[lengths > 0, None]
    offsets = np.einsum("ij,ij->i", normals, triples[lengths > 0, 0])
    sample = points[some]  # drawn by weight: its median is the weighted one
    if not len(normals):
        return Plane(np.array([0.0, 0.0, 1.0]), float(points[0, 2]), 0.0)
    medians = np.median(np.abs(sample @ normals.T - offsets), axis=0)
    best = int(medians.argmin())
    plane = Plane(normals[best], float(offsets[best]), _DEVIATIONS * _MAD_TO_DEVIATION * float(medians[best]))
    for _ in range(_REFITS):
        near = plane.distance(points) <= plane.tolerance
        if near.sum() < 3:
            break
        center = np.average(points[near], axis=0, weights=weights[near])
        spread = points[near] - center
        normal = np.linalg.eigh((spread * weights[near, None]).T @ spread)[1][:, 0]
        median = float(np.median(np.abs(sample @ normal - center @ normal)))
        plane = Plane(normal, float(center @ normal), _DEVIATIONS * _MAD_TO_DEVIATION * median)
    return plane


def find_surfaces(objects: Sequence[Candidate], gaussians: Gaussians, size: F32) -> dict[int, Plane]:
    """Returns the planes of large and flat objects, by number; `size` [G] as in `Overlaps`."""
    surfaces = {}
    visible = float(size.sum())
    for number, obj in enumerate(objects):
        if obj.weight < _SURFACE_SHARE * visible or len(obj.rows) < 3:
            continue
        points, weights = gaussians.means[obj.rows].astype(np.float64), size[obj.rows].astype(np.float64)
        plane = fit_plane(points, weights)
        center = np.average(points, axis=0, weights=weights)
        extent = np.sqrt(np.average(((points - center) ** 2).sum(axis=1), weights=weights))
        if plane.tolerance <= _SURFACE_FLATNESS * extent:
            surfaces[number] = plane
    return surfaces


def lies_in(plane: Plane, rows: NDArray[np.int32], gaussians: Gaussians, size: F32) -> bool:
    """True if most Gaussians lie within half the tolerance, and their median offset is small."""
    weights = size[rows].astype(np.float64)
    signed = gaussians.means[rows].astype(np.float64) @ plane.normal - plane.offset
    order = np.argsort(signed)
    reached = np.cumsum(weights[order])
    if not len(rows) or reached[-1] <= 0:
        return False
    median = float(signed[order[np.searchsorted(reached, 0.5 * reached[-1])]])
    inside = np.abs(signed) <= _TIGHT * plane.tolerance
    return bool(weights[inside].sum() > _CORE * reached[-1]) and abs(median) <= _OFFSET * plane.tolerance


def lies_off(plane: Plane, rows: NDArray[np.int32], gaussians: Gaussians, size: F32) -> bool:
    """True if most of the Gaussians' weight is farther from the plane than its tolerance."""
    weights = size[rows].astype(np.float64)
    far = plane.distance(gaussians.means[rows]) > plane.tolerance
    return bool(weights[far].sum() > _CORE * weights.sum())


def join_surfaces(
    owners: Owners, objects: Sequence[Candidate], surfaces: Mapping[int, Plane], gaussians: Gaussians, size: F32
) -> Owners:
    """Adds to surfaces what lies in their planes and is connected with them.

    These are Gaussians without owner, and smaller objects with less support (prints on a cloth) that the surface's
    masks include or that have little support. Scissors on the cloth stay, as the cloth's masks end at their edges.
    Larger surfaces come first; a surface in the plane of a larger one adds nothing.
    """
    result = owners.copy()
    order = sorted(surfaces, key=lambda n: (-objects[n].weight, n))
    for place, number in enumerate(order):
        mask, plane = result == number, surfaces[number]
        if not mask.any() or any(_within(surfaces[larger], mask, gaussians, size) for larger in order[:place]):
            continue
        joins = (result == NOBODY) & (plane.distance(gaussians.means) <= plane.tolerance) & (size > 0)
        inside = np.zeros(len(size), np.bool_)
        inside[objects[number].rows] = True
        for piece, obj in enumerate(objects):
            rows = np.flatnonzero(result == piece).astype(np.int32)
            lesser = obj.support < objects[number].support and obj.weight < objects[number].weight
            included = size[rows] @ inside[rows] >= _PIECE_INSIDE * size[rows].sum()
            piece_of_it = included or obj.support < _PIECE_SUPPORT
            if lesser and piece_of_it and lies_in(plane, rows, gaussians, size):
                joins[rows] = True
        members = np.flatnonzero(mask | joins)
        part = components(gaussians, members)
        weights = np.bincount(part, size[members] * mask[members])
        solid = weights >= STRAY_SHARE * weights.sum()
        result[members[solid[part]]] = number
    return result


def _within(larger: Plane, mask: NDArray[np.bool_], gaussians: Gaussians, size: F32) -> bool:
    wide = replace(larger, tolerance=2 * larger.tolerance)
    return lies_in(wide, np.flatnonzero(mask).astype(np.int32), gaussians, size)


def surface_kinds(
    surfaces: dict[int, Plane], centers: dict[int, F64], cameras: F64, up: F64 | None
) -> dict[int, SurfaceKind]:
    """Classifies surfaces as floor, ceiling, wall, horizontal surface or other.

    The floor is the lowest level surface below all cameras, if another level one lies between (in a close-up the table
    is lowest); ceilings are level ones above all cameras, walls are upright ones.

    Args:
        centers: float64 [3] of each.
        cameras: float64 [V, 3], positions of the photos.
        up: unit vector; None if unknown: then all are "surface".
    """
    if up is None:
        return dict.fromkeys(surfaces, "surface")
    kinds: dict[int, SurfaceKind] = {}
    heights = cameras @ up
    level = {n: float(centers[n] @ up) for n, plane in surfaces.items() if abs(plane.normal @ up) > _LEVEL}
    lower = sorted((height, n) for n, height in level.items() if height < heights.min())
    for number, plane in surfaces.items():
        if number in level:
            above = level[number] > heights.max()
            kinds[number] = "ceiling" if above else "horizontal surface"
        else:
            kinds[number] = "wall" if abs(plane.normal @ up) < _UPRIGHT else "surface"
    if len(lower) > 1:
        kinds[lower[0][1]] = "floor"
    return kinds
