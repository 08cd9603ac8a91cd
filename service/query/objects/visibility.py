"""Best views of objects by visible projected area; further views of a prompted object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.objects.solid_gaussians import masses
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.geometry.camera import PosedCamera

F64 = NDArray[np.float64]

_NAMED = 5
_MAX_VIEWS = 64
_MAX_OCCLUDERS = 1 << 16
_MAX_SAMPLES = 256
_GRID = 64
_SLACK = 0.08


def best_views(scene: Scene, objects: Sequence[NDArray[np.int64]], weights: F64) -> tuple[tuple[str, ...], ...]:
    """Selects at most five cameras for each object (rows [K]), best first, by name.

    A Gaussian counts with its area over its squared distance, in pixels, if it is inside the image and at most 8 %
    behind the nearest opaque Gaussian of its cell and the neighboring cells, 64 cells to the longer side. Bounds: 64
    views spread evenly, 65,536 occluders, 256 Gaussians per object. `weights` are areas times opacities [G], see
    `masses`."""
    views, scores = view_scores(scene, objects, weights)
    if not views:
        return tuple(() for _ in objects)
    order = (-scores).argsort(axis=1, kind="stable")[:, :_NAMED]
    return tuple(
        tuple(views[view].name for view in best.tolist() if row[view] > 0)
        for best, row in zip(order, scores, strict=True)
    )


def view_scores(
    scene: Scene, objects: Sequence[NDArray[np.int64]], weights: F64, max_views: int = _MAX_VIEWS
) -> tuple[tuple[PosedCamera, ...], F64]:
    """Visible pixels of objects in named cameras, [objects, views], up to object factors.

    At most `max_views` cameras, spread evenly; none without objects. Other arguments as for `best_views`."""
    views = spread_views([posed for posed in scene.cameras if posed.name], max_views)
    if not views or not objects:
        return (), np.zeros((len(objects), 0))
    means = scene.gaussians.means
    opaque = np.flatnonzero((scene.gaussians.logit_opacities > 0) & np.isfinite(means).all(axis=1))
    occluders = means[opaque[:: -(-len(opaque) // _MAX_OCCLUDERS) or 1]].astype(np.float64)
    picks = [rows[:: -(-len(rows) // _MAX_SAMPLES)] for rows in objects]
    sampled = np.concatenate(picks)
    owner = np.repeat(np.arange(len(picks)), [len(pick) for pick in picks])
    points, areas = means[sampled].astype(np.float64), weights[sampled]
    scores = np.stack([_scores(posed, occluders, points, areas, owner, len(picks)) for posed in views], axis=1)
    return views, scores


def spread_views(cameras: Sequence[PosedCamera], most: int = _MAX_VIEWS) -> tuple[PosedCamera, ...]:
    """Selects at most `most` cameras, spread evenly over their order."""
    chosen = np.unique(np.linspace(0, len(cameras) - 1, min(len(cameras), most)).astype(int))
    return tuple(cameras[number] for number in chosen.tolist())


def shows(posed: PosedCamera, place: Sequence[float]) -> bool:
    """True if a world point is in a camera's picture, hidden or not."""
    return bool(len(posed.in_picture(np.array([place]))[0]))


class SightLines:
    """Depth buffer of points [K, 3] in a view, 64 cells to the longer side.

    Only the points are drawn. Holes between them are closed by the least of each 3×3 neighborhood, then the largest of
    those (a morphological closing), so that nothing grows.

    Attributes:
        nearest: float64 [C], z of the nearest point in each cell; infinite for none.
        front: int64 [C], row of that point.
    """

    def __init__(self, posed: PosedCamera, points: F64) -> None:
        self._posed = posed
        self._step = max(posed.camera.width, posed.camera.height) / _GRID
        self._columns = int(np.ceil(posed.camera.width / self._step))
        rows = int(np.ceil(posed.camera.height / self._step))
        nearest, front = np.full(rows * self._columns, np.inf), np.zeros(rows * self._columns, np.int64)
        cell, depth, ahead = self.cells(points)
        np.minimum.at(nearest, cell, depth)
        first = depth == nearest[cell]
        front[cell[first]] = ahead[first]
        near: NDArray[Any] = nearest.reshape(rows, -1)
        which: NDArray[Any] = front.reshape(rows, -1)
        for chosen in (np.argmin, np.argmax):
            best = chosen(_around(near), axis=0)[None]
            near, which = (np.take_along_axis(_around(values), best, axis=0)[0] for values in (near, which))
        self.nearest, self.front = near.ravel(), which.ravel()

    def cells(self, points: F64) -> tuple[NDArray[np.int64], F64, NDArray[np.int64]]:
        """Cell, z and row of the points inside the image."""
        rows, pixels, depths = self._posed.in_picture(points)
        return (pixels // self._step).astype(np.int64) @ np.array([1, self._columns]), depths, rows


def _around(values: NDArray[Any]) -> NDArray[Any]:
    """Each value and the eight around it, [9, H, W]."""
    padded = np.pad(values, 1, mode="edge")
    rows, columns = values.shape
    return np.stack([padded[y : y + rows, x : x + columns] for y in range(3) for x in range(3)])


def _scores(posed: PosedCamera, occluders: F64, points: F64, areas: F64, owner: NDArray[np.intp], count: int) -> F64:
    """Visible pixels of each object in one view, [count], up to the subsampling factor."""
    sight = SightLines(posed, occluders)
    cell, depth, inside = sight.cells(points)
    visible = depth <= sight.nearest[cell] * (1 + _SLACK)
    pixels = areas[inside] * posed.camera.fx * posed.camera.fy / depth**2
    return np.bincount(owner[inside], weights=pixels * visible, minlength=count).astype(np.float64)


_SAME_SIDE = 0.35
"""Radians within which a view adds little."""
_FAR, _OPPOSITE = 1.2, 2.2
"""Radians from which the segmented side fades, and is hardly visible."""
_LEAST = 0.05


def further_views(scene: Scene, rows: NDArray[np.int64], first: PosedCamera, count: int) -> tuple[PosedCamera, ...]:
    """Selects at most `count` cameras that see Gaussians `rows` [K] from new sides, best first."""
    gaussians = scene.gaussians
    views, scores = view_scores(scene, [rows], masses(gaussians.log_scales, gaussians.logit_opacities))
    if not views:
        return ()
    middle = np.median(gaussians.means[rows].astype(np.float64), axis=0)
    sides = np.stack([_side(posed, middle) for posed in views])
    seen = scores[0]
    # Scores above the median count the same: among large views the direction decides.
    seen = np.minimum(seen, np.median(seen[seen > 0])) if (seen > 0).any() else seen
    used, result = [_side(first, middle)], []
    for _ in range(count):
        angle = np.arccos(np.clip(sides @ np.stack(used).T, -1, 1)).min(axis=1)
        fits = np.clip((_OPPOSITE - angle) / (_OPPOSITE - _FAR), _LEAST, 1)
        value = seen * np.clip(angle / _SAME_SIDE, 0, 1) * fits
        best = int(value.argmax())
        if value[best] <= 0:
            break
        result.append(views[best])
        used.append(sides[best])
    return tuple(result)


def _side(posed: PosedCamera, point: NDArray[np.float64]) -> NDArray[np.float64]:
    direction = posed.world_from_camera[:3, 3] - point
    return np.asarray(direction / max(float(np.linalg.norm(direction)), 1e-12))
