"""Position, size and color of objects, measured once per scene version."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError, cKDTree

from fastsplat.service.common.logistic import logistic
from fastsplat.service.query.objects.color_names import color_distance, color_shares, lab_of
from fastsplat.service.query.objects.solid_gaussians import grouped_rows, masses, solid_rows
from fastsplat.service.scene.artefact.scene import SH_C0, Scene
from fastsplat.service.scene.objects.boxes import oriented_box
from fastsplat_contract.geometry.poses import Box, Vector3, vector3

F64 = NDArray[np.float64]
Rows = NDArray[np.int64]

_MAX_POINTS = 1_200
_MAX_COLORED, _MAX_COMPARED = 4_096, 512
_NEIGHBORS = 4
_APART = 6.0
_WIDEST = 4.0
_TRIM = 0.015
"""Share of points trimmed at either end of each axis."""


@dataclass(frozen=True)
class ObjectShape:
    """Shape of one object, z up if known (see `ObjectMeasures`), else in world axes.

    Attributes:
        size: edges of its box: longer and shorter horizontal, vertical; if up is unknown, along the principal axes.
            Unlike `oriented_box`, 1.5 % of the points are trimmed at either end, so that sizes are comparable.
        low, high: z of its lowest and highest place.
    """

    id: int  # of the object
    points: F64  # float64 [K, 3], K ≥ 1: at most 1,200 of its Gaussians, without those far from all others
    center: F64  # float64 [3], the middle of its box
    size: tuple[float, float, float]
    low: float
    high: float
    deviation: float  # median standard deviation of its Gaussians: how sure its surface is

    @cached_property
    def tree(self) -> cKDTree:
        return cKDTree(self.points)

    @cached_property
    def spacing(self) -> float:
        """Median distance between neighboring points."""
        if len(self.points) < 2:
            return 0.0
        return float(np.median(self.tree.query(self.points, k=[2])[0]))

    @cached_property
    def bounds(self) -> F64:
        """Least and largest x and y of its points, float64 [2, 2]."""
        return np.stack([self.points[:, :2].min(axis=0), self.points[:, :2].max(axis=0)])

    @cached_property
    def outline(self) -> F64:
        """Half planes (a, b, c) of the convex outline from above, float64 [E, 3].

        A point (x, y) is outside by the largest a·x + b·y + c."""
        flat = self.points[:, :2]
        if len(flat) >= 3:
            try:
                return np.asarray(ConvexHull(flat).equations)
            except QhullError:
                pass  # all on one line: their rectangle along the axes
        (left, front), (right, back) = self.bounds
        return np.array([[1.0, 0.0, -right], [-1.0, 0.0, left], [0.0, 1.0, -back], [0.0, -1.0, front]])

    def outside(self, flat: F64) -> F64:
        """Distance of points [K, 2] outside the outline, [K]; negative inside."""
        edges = self.outline
        return np.asarray((flat @ edges[:, :2].T + edges[:, 2]).max(axis=1))

    @property
    def width(self) -> float:
        """Mean horizontal side."""
        return (self.size[0] + self.size[1]) / 2


@dataclass(frozen=True)
class ObjectColor:
    """The color of an object."""

    lab: F64  # float64 [3], CIELAB (D65): the medians of its Gaussians' constant colors, weighted by opacity times area
    spread: float  # the median distance of their colors from that one, CIE94
    shares: Mapping[str, float]  # 0..1 by name, on how much of it that is clearly its color


@dataclass
class ObjectMeasures:
    """Lazy measurements of a scene's objects; thread-safe."""

    scene: Scene  # its Gaussians, and what is up
    owners: tuple[NDArray[np.int32], ...]  # int32 [G] each: the object of each Gaussian, and the part, 0 for none
    _shapes: dict[int, ObjectShape] = field(default_factory=dict)
    _colors: dict[int, ObjectColor] = field(default_factory=dict)

    @cached_property
    def up(self) -> F64 | None:
        """Unit up vector in the world; None if unknown."""
        return self.scene.up()

    @cached_property
    def axes(self) -> F64:
        """Axes of shapes in the world, rows of float64 [3, 3]; the last one is up."""
        if self.up is None:
            return np.eye(3)
        first = np.cross(np.eye(3)[np.abs(self.up).argmin()], self.up)
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(self.up, first), self.up])

    @cached_property
    def _rows(self) -> dict[int, Rows]:
        solid = solid_rows(self.scene.gaussians)
        return {object_id: rows for owner in self.owners for object_id, rows in grouped_rows(owner, solid)}

    def shape(self, object_id: int) -> ObjectShape | None:
        """Shape of an object or part; None if invisible."""
        if object_id not in self._shapes and object_id in self._rows:
            self._shapes[object_id] = self._shape(object_id)
        return self._shapes.get(object_id)

    def color(self, object_id: int) -> ObjectColor | None:
        """Color of an object or part; None if invisible."""
        if object_id not in self._colors and object_id in self._rows:
            self._colors[object_id] = self._color(_thinned(self._rows[object_id], _MAX_COLORED))
        return self._colors.get(object_id)

    def _shape(self, object_id: int) -> ObjectShape:
        gaussians = self.scene.gaussians
        rows = _thinned(self._rows[object_id], _MAX_POINTS)
        means = gaussians.means[rows].astype(np.float64)
        if len(means) > _NEIGHBORS:
            away = cKDTree(means).query(means, k=[_NEIGHBORS + 1])[0][:, 0]
            near = away <= _APART * max(float(np.median(away)), np.finfo(np.float64).tiny)
            means, rows = means[near], rows[near]
        points = means @ self.axes.T
        center, size = _upright_box(points) if self.up is not None else _principal_box(points)
        low, high = np.quantile(points[:, 2], [_TRIM, 1 - _TRIM])
        deviation = float(np.median(np.exp(gaussians.log_scales[rows].astype(np.float64))))
        return ObjectShape(object_id, points, center, size, float(low), float(high), deviation)

    def _color(self, rows: Rows) -> ObjectColor:
        gaussians = self.scene.gaussians
        lab = lab_of(np.clip(0.5 + SH_C0 * gaussians.sh[rows, 0].astype(np.float64), 0.0, 1.0))
        weights = _bounded(masses(gaussians.log_scales[rows], gaussians.logit_opacities[rows]))
        median = _weighted_median(lab, weights)
        spread = float(_weighted_median(color_distance(lab, median), weights))
        some = _thinned(np.arange(len(lab)), _MAX_COMPARED)
        return ObjectColor(median, spread, color_shares(lab[some], weights[some]))


def _upright_box(points: F64) -> tuple[F64, tuple[float, float, float]]:
    """Center and edges of the upright box of least base, in 3-degree steps."""
    angles = np.radians(np.arange(0.0, 90.0, 3.0))
    along = points[:, :2] @ np.stack([np.cos(angles), np.sin(angles)])
    aside = points[:, :2] @ np.stack([-np.sin(angles), np.cos(angles)])
    ends = np.quantile(np.concatenate([along, aside, points[:, 2:]], axis=1), [_TRIM, 1 - _TRIM], axis=0)
    middles, lengths = ends.mean(axis=0), ends[1] - ends[0]
    count = len(angles)
    best = int((lengths[:count] * lengths[count:-1]).argmin())
    x, y = middles[best], middles[count + best]
    cosine, sine = np.cos(angles[best]), np.sin(angles[best])
    center = np.array([cosine * x - sine * y, sine * x + cosine * y, middles[-1]])
    short, long = sorted((float(lengths[best]), float(lengths[count + best])))
    return center, (long, short, float(lengths[-1]))


def _principal_box(points: F64) -> tuple[F64, tuple[float, float, float]]:
    """Center and edges, longest first, of the box along the principal axes."""
    mean = points.mean(axis=0)
    axes = np.linalg.eigh((points - mean).T @ (points - mean))[1]
    ends = np.quantile((points - mean) @ axes, [_TRIM, 1 - _TRIM], axis=0)
    long, middle, short = sorted((ends[1] - ends[0]).tolist(), reverse=True)
    return mean + axes @ ends.mean(axis=0), (long, middle, short)


class Extent(NamedTuple):
    """Extent of a visible object."""

    box: Box  # see `oriented_box`
    centroid: Vector3  # the mean of its surface, scene units
    opacity: float  # the sum of its Gaussians' opacities: how large it is beside others


def extents_of(scene: Scene, owner: NDArray[np.int32]) -> dict[int, Extent]:
    """Extents of visible objects by id, for owners int32 [G], 0 for none."""
    gaussians = scene.gaussians
    weights = masses(gaussians.log_scales, gaussians.logit_opacities)
    up = scene.up()
    means = gaussians.means.astype(np.float64)
    opacities = logistic(gaussians.logit_opacities)
    extents = {}
    for object_id, rows in grouped_rows(owner, solid_rows(gaussians)):
        object_weights = _bounded(weights[rows])
        middle = vector3(np.average(means[rows], axis=0, weights=object_weights))
        extents[object_id] = Extent(oriented_box(means[rows], object_weights, up), middle, float(opacities[rows].sum()))
    return extents


def _bounded(weights: F64) -> F64:
    """Caps weights so that wide leaked Gaussians do not dominate."""
    return np.minimum(weights, _WIDEST * np.median(weights))


def _thinned(rows: Rows, most: int) -> Rows:
    return rows[:: -(-len(rows) // most)]


def _weighted_median(values: F64, weights: F64) -> F64:
    return np.asarray(np.quantile(values, 0.5, axis=0, weights=weights, method="inverted_cdf"))
