"""Unseen space: the share of a place that no photo shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.objects.absence import ALL_SEEN, USUAL_M, Hollow, UnseenSpace
from fastsplat.service.query.objects.solid_gaussians import grouped_rows, solid_rows
from fastsplat.service.query.objects.visibility import SightLines, shows, spread_views
from fastsplat.service.scene.artefact.scene import Scene, SurfaceKind
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import Vector3

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

_ACROSS = 10
"""Cubes along the shortest side of an object."""
_MOST_OBJECTS = 64
_MAX_POINTS = 65_536
_MOST_LARGE = 8_192
_MOST_NAMED = 2
_BOUNDARIES: tuple[SurfaceKind, ...] = ("floor", "ceiling", "wall")
"""Surfaces that bound the place."""

_Mask = NDArray[np.bool_]

_FINEST = 1 / 40
"""Least width of a cube, as a share of the longest side."""
_MAX_HULL_POINTS = 2_000
_TRIM = 0.01
"""Share of points trimmed at either end of each axis."""


def surface_kind(name: str, kind: SurfaceKind = "") -> SurfaceKind:
    """Kind of surface of an object or label: the stored one, else a boundary's name."""
    return kind or next((boundary for boundary in _BOUNDARIES if label_key(name) == boundary), "")


def unseen_space(scene: Scene, owner: I32, surfaces: Mapping[int, SurfaceKind]) -> UnseenSpace:
    """Estimates the unseen space between and inside a scene's objects.

    The place is the convex hull of the objects' Gaussians, in cubes, 40 along its longest side. A photo sees a cube if
    its center is in the picture and at most one cube width behind the nearest opaque Gaussian of its cell and
    neighboring cells. A cube is unseen if photos have it in the picture and none sees it, and outside of the place if
    mostly floors, ceilings and walls hide it. Connected unseen cubes count if a ball fits in that is as wide as the
    median object is long.

    The hulls of the largest objects are searched likewise, in cubes of their own; there a cube is unseen if no photo
    sees it and the object itself hides it in at least half of those that look towards it. Bounds: 64 views, 65,536
    Gaussians, 64 objects.

    Args:
        scene: its cameras and Gaussians.
        owner: int32 [G]: the object or the label of each Gaussian, 0 for none.
        surfaces: kinds of those that are surfaces.
    """
    if not scene.cameras:
        return ALL_SEEN
    rows = opaque_rows(scene)
    points, of = scene.gaussians.means[rows].astype(np.float64), owner[rows]
    place = _cube_grid(points[of > 0], 0)
    if place is None:
        return ALL_SEEN
    trimmed = [np.quantile(group, [_TRIM, 1 - _TRIM], axis=0) for _, group in _objects_of(points, of, surfaces)]
    usual = float(np.median([np.ptp(ends, axis=0).max() for ends in trimmed])) if trimmed else 0.0
    seen, *insides = _looks(scene, rows, of, surfaces, [place, *_grids_of_objects(points, of, surfaces)])
    hollows = [hollow for inside in insides if (hollow := _inside(inside, scene.cameras))]
    metric, (share, behind, middle) = scene.scale == "METRIC", _between(seen, usual)
    if not share and not hollows:
        return ALL_SEEN
    hollows.sort(key=lambda hollow: -hollow.volume)
    meter = 1.0 if metric else usual / USUAL_M
    return UnseenSpace(share, behind, middle, hollows=tuple(hollows), meter=meter, in_meters=metric)


@dataclass(frozen=True)
class _Looked:
    """Visibility counts of a grid's cubes."""

    grid: _CubeGrid  # K cubes
    seen: NDArray[np.int64]  # int64 [K], how many photos see the cube
    hidden: NDArray[np.int64]  # how many have it in the picture behind something
    outside: NDArray[np.int64]  # in how many of these that is a floor, a ceiling or a wall
    of_object: NDArray[np.int64]  # in how many it is the grid's object
    behind: NDArray[np.int64]  # the last object that was before it, and is none of those; 0 for none


def _looks(
    scene: Scene, rows: NDArray[np.int64], of: I32, surfaces: Mapping[int, SurfaceKind], grids: Sequence[_CubeGrid]
) -> list[_Looked]:
    """Counts the views of the cubes of some grids; `of`: objects of the Gaussians `rows`."""
    boundary = np.zeros(int(of.max(initial=0)) + 1, np.bool_)
    boundary[[number for number, kind in surfaces.items() if kind in _BOUNDARIES and number < len(boundary)]] = True
    counts = [len(grid.middles) for grid in grids]
    middles = np.concatenate([grid.middles for grid in grids])
    widths = np.repeat([grid.width for grid in grids], counts)
    inside_of = np.repeat([grid.object_id for grid in grids], counts)
    seen, hidden, outside, self_hidden, behind = np.zeros((5, len(middles)), np.int64)
    opaque, whose = hiding_points(scene, rows, of)
    for posed in spread_views(scene.cameras):
        sight = SightLines(posed, opaque)
        cell, depth, ahead = sight.cells(middles)
        visible = depth <= sight.nearest[cell] + widths[ahead]
        seen[ahead[visible]] += 1
        hiding, by = ahead[~visible], whose[sight.front[cell[~visible]]]
        hidden[hiding] += 1
        outside[hiding] += boundary[by]
        self_hidden[hiding] += by == inside_of[hiding]
        behind[hiding[~boundary[by]]] = by[~boundary[by]]
    ends = np.cumsum(counts)[:-1]
    parts = (np.split(values, ends) for values in (seen, hidden, outside, self_hidden, behind))
    return [_Looked(*row) for row in zip(grids, *parts, strict=True)]


def _between(place: _Looked, usual: float) -> tuple[float, tuple[int, ...], Vector3 | None]:
    """Computes `share`, `behind` and `middle` of `UnseenSpace`."""
    unseen = (place.seen == 0) & (place.hidden > 0) & (2 * place.outside <= place.hidden)
    pieces = _pieces_of(place.grid, unseen)
    counted = unseen & (pieces.widths >= usual)[pieces.numbers]
    if not counted.any():
        return 0.0, (), None
    ids, counts = np.unique(place.behind[counted & (place.behind > 0)], return_counts=True)
    order = (-counts).argsort(kind="stable")[:_MOST_NAMED]
    share = float(counted.sum() / ((place.seen > 0) | unseen).sum())
    return share, tuple(ids[order].tolist()), pieces.middles[int(pieces.widths.argmax())]


def _inside(obj: _Looked, cameras: Sequence[PosedCamera]) -> Hollow | None:
    """Unseen piece of an object's inside with the largest ball; None for none."""
    pieces = _pieces_of(obj.grid, _most_around(obj.grid, (obj.seen == 0) & (2 * obj.of_object >= obj.hidden)))
    best = int(pieces.widths.argmax())
    if not best or not obj.hidden.any():
        return None
    volume = float((pieces.numbers == best).sum()) * obj.grid.width**3
    middle = pieces.middles[best]
    able = [camera for camera in cameras if shows(camera, middle)]
    far = {camera.name: np.linalg.norm(camera.world_from_camera[:3, 3] - middle) for camera in able}
    nearest = min(far, key=far.__getitem__, default="")
    return Hollow(obj.grid.object_id, volume, float(pieces.widths[best]), middle, nearest)


def _grids_of_objects(points: F64, of: I32, surfaces: Mapping[int, SurfaceKind]) -> list[_CubeGrid]:
    """Cubes of the largest objects that are no surfaces."""
    groups = _objects_of(points, of, surfaces)
    groups.sort(key=lambda group: -float(np.ptp(group[1], axis=0).prod()))
    grids = (_cube_grid(object_points, object_id, _ACROSS) for object_id, object_points in groups[:_MOST_OBJECTS])
    return [grid for grid in grids if grid is not None]


def opaque_rows(scene: Scene) -> NDArray[np.int64]:
    """Rows of at most 65,536 opaque Gaussians, spread evenly, int64 [K]."""
    rows = solid_rows(scene.gaussians)
    rows = rows[scene.gaussians.logit_opacities[rows] > 0]
    return rows[:: -(-len(rows) // _MAX_POINTS) or 1]


def hiding_points(scene: Scene, rows: NDArray[np.int64], of: I32) -> tuple[F64, I32]:
    """Occluding points [K, 3], world frame, and their owners, int32 [K].

    These are the means of Gaussians `rows` of objects `of` and, for the 8,192 largest, also points one standard
    deviation along their two longest axes; between means alone one would look through plain faces."""
    gaussians = scene.gaussians
    scales = np.exp(gaussians.log_scales[rows].astype(np.float64))
    large = np.argsort(-scales.max(axis=1), kind="stable")[:_MOST_LARGE]
    turns = Rotation.from_quat(gaussians.quats[rows[large]].astype(np.float64), scalar_first=True).as_matrix()
    longest = np.argsort(-scales[large], axis=1)[:, None, :2]
    steps = np.take_along_axis(turns * scales[large, None, :], longest, axis=2)
    middles = gaussians.means[rows].astype(np.float64)
    edges = [middles[large] + sign * steps[:, :, axis] for axis in (0, 1) for sign in (-1, 1)]
    return np.concatenate([middles, *edges]), np.concatenate([of, np.tile(of[large], 4)])


def _objects_of(points: F64, of: I32, surfaces: Mapping[int, SurfaceKind]) -> list[tuple[int, F64]]:
    """Points of each object that is no surface, by id."""
    groups = grouped_rows(of, np.arange(len(of)))
    return [(object_id, points[rows]) for object_id, rows in groups if not surfaces.get(object_id)]


@dataclass(frozen=True)
class _CubeGrid:
    """Cubes inside a convex hull."""

    object_id: int  # whose hull; 0 for all together
    inside: _Mask  # bool [X, Y, Z], which cubes are inside
    middles: F64  # float64 [K, 3], their middles, world frame
    width: float  # of a cube, scene units


@dataclass(frozen=True)
class _Pieces:
    """Connected components of a grid's cubes."""

    numbers: NDArray[np.int64]  # int64 [K], of which piece each cube inside the hull is, from 1; 0 for none
    widths: F64  # float64 [P + 1], of the largest ball that fits into each piece, scene units; 0 first
    middles: tuple[Vector3, ...]  # P + 1 middles of these balls, world frame


def _cube_grid(points: F64, object_id: int, across: int = 0) -> _CubeGrid | None:
    """Voxelizes the convex hull of points [K, 3]; None without volume.

    `across`: cubes along the shortest side; at most 40 along the longest side, as for 0."""
    if len(points) < 4:
        return None
    low, high = np.quantile(points, [_TRIM, 1 - _TRIM], axis=0)
    core = points[((points >= low) & (points <= high)).all(axis=1)]
    try:
        planes = ConvexHull(core[:: -(-len(core) // _MAX_HULL_POINTS) or 1]).equations
    except (QhullError, ValueError):
        return None
    size = high - low
    width = float(max(size.max() * _FINEST, size.min() / across if across else 0.0))
    if not width:
        return None
    counts = np.maximum(np.ceil(size / width), 1).astype(int)
    axes = [start + (np.arange(count) + 0.5) * width for start, count in zip(low, counts, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = np.ones(grid.shape[:3], np.bool_)
    for a, b, c, d in planes:
        inside &= grid @ np.array([a, b, c]) + d <= 0
    return _CubeGrid(object_id, inside, grid[inside], width) if inside.any() else None


def _most_around(grid: _CubeGrid, marked: _Mask) -> _Mask:
    """Majority filter over the 3×3×3 neighborhoods inside the hull, bool [K]."""
    from scipy import ndimage

    whole = np.zeros((2, *grid.inside.shape))
    whole[0][grid.inside], whole[1] = marked, grid.inside
    share, there = (ndimage.uniform_filter(values, 3, mode="constant")[grid.inside] for values in whole)
    return np.asarray(2 * share > there)


def _pieces_of(grid: _CubeGrid, marked: _Mask) -> _Pieces:
    """Connected components of the marked cubes, bool [K], inside a grid's hull."""
    from scipy import ndimage  # no other question needs it

    whole = np.zeros(grid.inside.shape, np.bool_)
    whole[grid.inside] = marked
    numbers, count = ndimage.label(whole)
    within = ndimage.distance_transform_edt(np.pad(whole, 1))[1:-1, 1:-1, 1:-1][grid.inside]
    cube_numbers = numbers[grid.inside].astype(np.int64)
    deepest = [0, *(int(np.where(cube_numbers == number, within, 0).argmax()) for number in range(1, count + 1))]
    widths = (2 * within[deepest] - 1) * grid.width
    widths[0] = 0.0
    return _Pieces(cube_numbers, widths, tuple(Vector3(*grid.middles[row].tolist()) for row in deepest))
