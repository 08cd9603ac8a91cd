"""The views that see an object best, by the projected area that nothing nearer hides; nothing is rendered."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.types import Scene
from fastsplat_contract.camera import PosedCamera

F64 = NDArray[np.float64]

_NAMED = 5
_MAX_VIEWS = 64
_MAX_OCCLUDERS = 1 << 16
_MAX_SAMPLES = 256
_GRID = 64
_SLACK = 0.08
_NEAR = 1e-6


def best_views(scene: Scene, objects: Sequence[NDArray[np.int64]], weights: F64) -> tuple[tuple[str, ...], ...]:
    """For each object (rows of Gaussians) the names of at most five cameras, best first.

    A Gaussian counts with its area over its squared distance, in pixels, if it lies inside the image and no more than
    8 % behind the nearest opaque Gaussian of its cell and the cells around it, 64 cells to the longer side. The cost is
    bounded: 64 views spread evenly, 65,536 occluders, 256 Gaussians an object.

    Args:
        scene: its cameras and Gaussians.
        objects: int64 [K] each.
        weights: float64 [G], area times opacity, see `masses`.
    """
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
    """At most `max_views` of the scene's named cameras, spread evenly, and float64 [objects, views], how many pixels
    each shows of each object, up to a factor of the object's; arguments as for `best_views`. No views without cameras
    or objects."""
    named = [posed for posed in scene.cameras if posed.name]
    if not named or not objects:
        return (), np.zeros((len(objects), 0))
    views = [named[i] for i in np.unique(np.linspace(0, len(named) - 1, min(len(named), max_views)).astype(int))]
    means = scene.gaussians.means
    opaque = np.flatnonzero((scene.gaussians.logit_opacities > 0) & np.isfinite(means).all(axis=1))
    occluders = means[opaque[:: -(-len(opaque) // _MAX_OCCLUDERS) or 1]].astype(np.float64)
    picks = [rows[:: -(-len(rows) // _MAX_SAMPLES)] for rows in objects]
    sampled = np.concatenate(picks)
    owner = np.repeat(np.arange(len(picks)), [len(pick) for pick in picks])
    points, areas = means[sampled].astype(np.float64), weights[sampled]
    scores = np.stack([_scores(posed, occluders, points, areas, owner, len(picks)) for posed in views], axis=1)
    return tuple(views), scores


def _scores(posed: PosedCamera, occluders: F64, points: F64, areas: F64, owner: NDArray[np.intp], count: int) -> F64:
    """[count]: visible pixels of each object in one view, up to the thinning of its Gaussians."""
    camera = posed.camera
    step = max(camera.width, camera.height) / _GRID
    columns = int(np.ceil(camera.width / step))
    nearest = np.full(columns * int(np.ceil(camera.height / step)), np.inf)
    cell, depth, _ = _cells(posed, occluders, step, columns)
    np.minimum.at(nearest, cell, depth)
    # Only centers were drawn: the cells around close the holes between them.
    nearest = _least_around(nearest.reshape(-1, columns)).ravel()
    cell, depth, inside = _cells(posed, points, step, columns)
    visible = depth <= nearest[cell] * (1 + _SLACK)
    pixels = areas[inside] * camera.fx * camera.fy / depth**2
    return np.bincount(owner[inside], weights=pixels * visible, minlength=count).astype(np.float64)


def _least_around(values: F64) -> F64:
    """[H, W]: the least of each cell and the eight around it."""
    columns = np.pad(values, ((0, 0), (1, 1)), mode="edge")
    across = np.minimum(np.minimum(columns[:, :-2], columns[:, 2:]), values)
    rows = np.pad(across, ((1, 1), (0, 0)), mode="edge")
    return np.asarray(np.minimum(np.minimum(rows[:-2], rows[2:]), across))


def _cells(
    posed: PosedCamera, points: F64, step: float, columns: int
) -> tuple[NDArray[np.int64], F64, NDArray[np.int64]]:
    """Cell and z of the points inside the image, and which points those are."""
    camera, pose = posed.camera, posed.camera_from_world()
    x, y, z = (points @ pose[:3, :3].T + pose[:3, 3]).T
    ahead = np.flatnonzero(z > _NEAR)
    z = z[ahead]
    u, v = camera.fx * x[ahead] / z + camera.cx, camera.fy * y[ahead] / z + camera.cy
    within = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    cell = (v[within] // step).astype(np.int64) * columns + (u[within] // step).astype(np.int64)
    return cell, z[within], ahead[within]
