"""Unseen space: the share of a place that no photo shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.things.absence import ALL_SEEN, USUAL_M, Hollow, UnseenSpace
from fastsplat.service.query.things.cube_grids import TRIM, CubeGrid, cube_grid, most_around, pieces_of
from fastsplat.service.query.things.solid_gaussians import grouped_rows, solid_rows
from fastsplat.service.query.things.visibility import SightLines, shows, spread_views
from fastsplat.service.scene.artefact.scene import Scene, SurfaceKind
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import Vector3

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

_ACROSS = 10
"""Cubes along the shortest side of a thing."""
_MOST_THINGS = 64
_MAX_POINTS = 65_536
_MOST_LARGE = 8_192
_MOST_NAMED = 2
_BOUNDARIES: tuple[SurfaceKind, ...] = ("floor", "ceiling", "wall")
"""Surfaces that bound the place."""


def surface_kind(name: str, kind: SurfaceKind = "") -> SurfaceKind:
    """Kind of surface of a thing or label: the stored one, else a boundary's name."""
    return kind or next((each for each in _BOUNDARIES if label_key(name) == each), "")


def unseen_space(scene: Scene, owner: I32, surfaces: Mapping[int, SurfaceKind]) -> UnseenSpace:
    """Estimates the unseen space between and inside a scene's things.

    The place is the convex hull of the things' Gaussians, in cubes, 40 along its longest side. A photo sees a cube if
    its center is in the picture and at most one cube width behind the nearest opaque Gaussian of its cell and
    neighboring cells. A cube is unseen if photos have it in the picture and none sees it, and outside of the place if
    mostly floors, ceilings and walls hide it. Connected unseen cubes count if a ball fits in that is as wide as the
    median thing is long.

    The hulls of the largest things are searched likewise, in cubes of their own; there a cube is unseen if no photo
    sees it and the thing itself hides it in at least half of those that look towards it. Bounds: 64 views, 65,536
    Gaussians, 64 things.

    Args:
        scene: its cameras and Gaussians.
        owner: int32 [G]: the thing or the label of each Gaussian, 0 for none.
        surfaces: kinds of those that are surfaces.
    """
    if not scene.cameras:
        return ALL_SEEN
    rows = opaque_rows(scene)
    points, of = scene.gaussians.means[rows].astype(np.float64), owner[rows]
    place = cube_grid(points[of > 0], 0)
    if place is None:
        return ALL_SEEN
    usual = _usual_size(points, of, surfaces)
    seen, *others = _looks(scene, rows, of, surfaces, [place, *_grids_of_things(points, of, surfaces)])
    hollows = [hollow for each in others if (hollow := _inside(each, scene.cameras))]
    metric, (share, behind, middle) = scene.scale == "METRIC", _between(seen, usual)
    if not share and not hollows:
        return ALL_SEEN
    return UnseenSpace(
        share,
        behind,
        middle,
        hollows=tuple(sorted(hollows, key=lambda each: -each.volume)),
        meter=1.0 if metric else usual / USUAL_M,
        in_meters=metric,
    )


@dataclass(frozen=True)
class _Looked:
    """Visibility counts of a grid's cubes."""

    grid: CubeGrid  # K cubes
    seen: NDArray[np.int64]  # int64 [K], how many photos see the cube
    hidden: NDArray[np.int64]  # how many have it in the picture behind something
    outside: NDArray[np.int64]  # in how many of these that is a floor, a ceiling or a wall
    own: NDArray[np.int64]  # in how many it is the grid's thing
    behind: NDArray[np.int64]  # the last thing that was before it, and is none of those; 0 for none


def _looks(
    scene: Scene, rows: NDArray[np.int64], of: I32, surfaces: Mapping[int, SurfaceKind], grids: Sequence[CubeGrid]
) -> list[_Looked]:
    """Counts the views of the cubes of some grids; `of`: things of the Gaussians `rows`."""
    boundary = np.zeros(int(of.max(initial=0)) + 1, np.bool_)
    boundary[[each for each, kind in surfaces.items() if kind in _BOUNDARIES and each < len(boundary)]] = True
    counts = [len(grid.middles) for grid in grids]
    middles = np.concatenate([grid.middles for grid in grids])
    widths = np.repeat([grid.width for grid in grids], counts)
    inside_of = np.repeat([grid.thing_id for grid in grids], counts)
    seen, hidden, outside, own, behind = np.zeros((5, len(middles)), np.int64)
    opaque, whose = hiding_points(scene, rows, of)
    for posed in spread_views(scene.cameras):
        sight = SightLines(posed, opaque)
        cell, depth, ahead = sight.cells(middles)
        visible = depth <= sight.nearest[cell] + widths[ahead]
        seen[ahead[visible]] += 1
        hiding, by = ahead[~visible], whose[sight.front[cell[~visible]]]
        hidden[hiding] += 1
        outside[hiding] += boundary[by]
        own[hiding] += by == inside_of[hiding]
        behind[hiding[~boundary[by]]] = by[~boundary[by]]
    ends = np.cumsum(counts)[:-1]
    parts = (np.split(values, ends) for values in (seen, hidden, outside, own, behind))
    return [_Looked(*each) for each in zip(grids, *parts, strict=True)]


def _between(place: _Looked, usual: float) -> tuple[float, tuple[int, ...], Vector3 | None]:
    """Computes `share`, `behind` and `middle` of `UnseenSpace`."""
    unseen = (place.seen == 0) & (place.hidden > 0) & (2 * place.outside <= place.hidden)
    pieces = pieces_of(place.grid, unseen)
    counted = unseen & (pieces.widths >= usual)[pieces.numbers]
    if not counted.any():
        return 0.0, (), None
    ids, counts = np.unique(place.behind[counted & (place.behind > 0)], return_counts=True)
    order = (-counts).argsort(kind="stable")[:_MOST_NAMED]
    share = float(counted.sum() / ((place.seen > 0) | unseen).sum())
    return share, tuple(ids[order].tolist()), pieces.middles[int(pieces.widths.argmax())]


def _inside(thing: _Looked, cameras: Sequence[PosedCamera]) -> Hollow | None:
    """Unseen piece of a thing's inside with the largest ball; None for none."""
    pieces = pieces_of(thing.grid, most_around(thing.grid, (thing.seen == 0) & (2 * thing.own >= thing.hidden)))
    best = int(pieces.widths.argmax())
    if not best or not thing.hidden.any():
        return None
    volume = float((pieces.numbers == best).sum()) * thing.grid.width**3
    middle = pieces.middles[best]
    return Hollow(thing.grid.thing_id, volume, float(pieces.widths[best]), middle, _nearest_view(middle, cameras))


def _nearest_view(place: Vector3, cameras: Sequence[PosedCamera]) -> str:
    """Name of the nearest camera with a place in the picture; "" for none."""
    far = {each.name: np.linalg.norm(each.world_from_camera[:3, 3] - place) for each in cameras if shows(each, place)}
    return min(far, key=far.__getitem__, default="")


def _grids_of_things(points: F64, of: I32, surfaces: Mapping[int, SurfaceKind]) -> list[CubeGrid]:
    """Cubes of the largest things that are no surfaces."""
    groups = [(each, points[rows]) for each, rows in grouped_rows(of, np.arange(len(of))) if not surfaces.get(each)]
    groups.sort(key=lambda group: -float(np.ptp(group[1], axis=0).prod()))
    grids = (cube_grid(own, each, _ACROSS) for each, own in groups[:_MOST_THINGS])
    return [grid for grid in grids if grid is not None]


def opaque_rows(scene: Scene) -> NDArray[np.int64]:
    """Rows of at most 65,536 opaque Gaussians, spread evenly, int64 [K]."""
    rows = solid_rows(scene.gaussians)
    rows = rows[scene.gaussians.logit_opacities[rows] > 0]
    return rows[:: -(-len(rows) // _MAX_POINTS) or 1]


def hiding_points(scene: Scene, rows: NDArray[np.int64], of: I32) -> tuple[F64, I32]:
    """Occluding points [K, 3], world frame, and their owners, int32 [K].

    These are the means of Gaussians `rows` of things `of` and, for the 8,192 largest, also points one standard
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


def _usual_size(points: F64, of: I32, surfaces: Mapping[int, SurfaceKind]) -> float:
    """Median length of the things along their longest axis; 0 without things."""
    sizes = [
        np.ptp(np.quantile(points[rows], [TRIM, 1 - TRIM], axis=0), axis=0).max()
        for each, rows in grouped_rows(of, np.arange(len(of)))
        if not surfaces.get(each)
    ]
    return float(np.median(sizes)) if sizes else 0.0
