"""TSDF fusion of a scene's depth maps, and its surface net.

The signed distance follows Curless and Levoy (1996), truncated and averaged over views, in voxels near the surface
only. Meshing follows Gibson's surface nets (1998): one vertex in each voxel cube that the surface crosses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.surfaces.surface_points import BAND, MAX_SURFACE_POINTS, REACH, cell_keys, surface_points
from fastsplat.service.query.surfaces.surface_views import SurfaceSamples, SurfaceView, observed, projected
from fastsplat.service.scene.artefact.scene import F32
from fastsplat_contract.errors import LimitExceededError

I64 = NDArray[np.int64]

VOXELS_PER_POINT = 7
"""Voxels near a surface per cell of points; measured on a table-top scene."""

_TRUNCATION = 4.0
"""Truncation distance, voxels."""
_AROUND = 2
"""Voxels kept on either side of a surface point."""
_CHUNK = 1 << 20
_LEAST_FACES = 64
"""Connected components with fewer faces are removed."""
_STEPS = np.array([1 << 42, 1 << 21, 1], np.int64)
"""Key increments of one voxel along x, y and z, see `cell_keys`."""
_CORNERS = np.array(list(product((0, 1), repeat=3)), np.int64)
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1]


@dataclass(frozen=True)
class LabelledMesh:
    """A mesh with labels, objects, colors and confidence at its vertices."""

    vertices: SurfaceSamples  # see `SurfaceSamples`; normals are those of the mesh
    faces: I64  # int64 [F, 3], counter-clockwise seen from outside
    objects: NDArray[np.uint16]  # uint16 [F], the object of each face, 0 for none
    voxel: float  # its width, scene units


def surface_mesh(
    views: Sequence[SurfaceView], *, cell: float, most_voxels: int, limit: str, most_points: int = MAX_SURFACE_POINTS
) -> LabelledMesh:
    """Builds the mesh of a scene's surfaces; cancellable.

    `cell` is the voxel width; 0: as in `surface_points`, or wider so that `most_voxels` suffices. An explicit one that
    needs more raises LimitExceededError, in which `limit` names the bound."""
    most = min(most_points, max(1, most_voxels // VOXELS_PER_POINT))
    samples, voxel = surface_points(views, cell=cell, most=most, limit=limit)
    keys = _around(samples.points, voxel)
    if len(keys) > most_voxels:
        raise LimitExceededError(f"{len(keys)} voxels", field="cell", limit=limit, hint="Ask for a larger cell.")
    distances = fused(_centers(keys, voxel), views, _TRUNCATION * voxel)
    known = np.isfinite(distances)
    points, faces = surface_net(keys[known], distances[known], voxel)
    points, faces = _without_specks(points, faces)
    seen = observed(points, views, BAND * voxel)
    normals = _vertex_normals(points, faces)
    vertices = SurfaceSamples(**{**vars(seen), "normals": normals})
    first, second, third = (seen.objects[faces[:, corner]] for corner in range(3))
    return LabelledMesh(vertices, faces, np.where(second == third, second, first), voxel)


def fused(points: F32, views: Sequence[SurfaceView], truncation: float) -> F32:
    """Fuses the views' truncated signed distances at points [P, 3], float32 [P]; cancellable.

    In units of `truncation`, −1 to 1, positive in front of the surface: the confidence-weighted mean over views in
    which the point is not far behind their surface; NaN where there is none."""
    parts = [points[start : start + _CHUNK] for start in range(0, max(len(points), 1), _CHUNK)]
    return np.concatenate([_fused(part, views, np.float32(truncation)) for part in parts])


def _fused(points: F32, views: Sequence[SurfaceView], truncation: np.float32) -> F32:
    sums, weights = np.zeros(len(points), np.float32), np.zeros(len(points), np.float32)
    for view in views:
        check_cancelled()
        rows, pixels, z = projected(view, points)
        distance = (view.depth.reshape(-1)[pixels] - z) / truncation
        before = distance >= -1
        rows, pixels = rows[before], pixels[before]
        weight = view.confidence.reshape(-1)[pixels].astype(np.float32)
        sums[rows] += weight * np.minimum(distance[before], 1)
        weights[rows] += weight
    return np.where(weights > 0, sums / np.maximum(weights, np.float32(1e-9)), np.float32(np.nan))


def surface_net(keys: I64, distances: F32, voxel: float) -> tuple[F32, I64]:
    """Extracts vertices, float32 [V, 3], and triangles, int64 [F, 3], of the zero level.

    `keys` are ascending voxel keys, int64 [K] (see `cell_keys`), with distances at their centers, positive outside."""
    inside = distances < 0
    rows = np.stack([_places(keys, keys + corner @ _STEPS).astype(np.int32) for corner in _CORNERS], axis=1)
    whole = (rows >= 0).all(axis=1)
    crossed = np.zeros(len(keys), np.bool_)
    negative = inside[rows[whole]].sum(axis=1)
    crossed[whole] = (negative > 0) & (negative < 8)
    cubes = np.flatnonzero(crossed)
    values = distances[rows[cubes]].astype(np.float64)
    sums, counts = np.zeros((len(cubes), 3)), np.zeros((len(cubes), 1))
    for a, b in _EDGES:
        across = (values[:, a] < 0) != (values[:, b] < 0)
        share = np.where(across, values[:, a] / np.where(across, values[:, a] - values[:, b], 1), 0)[:, None]
        sums += across[:, None] * (_CORNERS[a] + share * (_CORNERS[b] - _CORNERS[a]))
        counts += across[:, None]
    points = _centers(keys[cubes], voxel) + voxel * sums / np.maximum(counts, 1)
    vertex = np.full(len(keys), -1, np.int64)
    vertex[cubes] = np.arange(len(cubes))
    faces = [_quads(keys, inside, vertex, axis) for axis in range(3)]
    return np.asarray(points, np.float32), np.concatenate(faces)


def _quads(keys: I64, inside: NDArray[np.bool_], vertex: I64, axis: int) -> I64:
    """Two triangles per crossed edge along an axis that has all four cubes."""
    ahead = _places(keys, keys + _STEPS[axis])
    edges = np.flatnonzero((ahead >= 0) & (inside != inside[ahead]))
    u, v = _STEPS[(axis + 1) % 3], _STEPS[(axis + 2) % 3]
    around = np.stack([_places(keys, keys[edges] - shift) for shift in (0 * u, u, u + v, v)], axis=1)
    corners = np.where(around >= 0, vertex[around], -1)
    whole = (corners >= 0).all(axis=1)
    corners, edges = corners[whole], edges[whole]
    corners = np.where(inside[edges][:, None], corners, corners[:, ::-1])  # seen from outside
    return np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])


def _places(keys: I64, queries: I64) -> I64:
    """Index of each of `queries` in the ascending `keys`, int64; −1 if missing."""
    places = np.minimum(np.searchsorted(keys, queries), max(len(keys) - 1, 0))
    return np.where(keys[places] == queries, places, -1) if len(keys) else np.full(len(queries), -1, np.int64)


def _around(points: F32, voxel: float) -> I64:
    """Ascending keys of the voxels within `_AROUND` of the points' voxels."""
    keys = np.unique(cell_keys(points, voxel)[0])
    for step in _STEPS:
        check_cancelled()
        keys = np.unique(np.concatenate([keys + number * step for number in range(-_AROUND, _AROUND + 1)]))
    return keys


def _centers(keys: I64, voxel: float) -> F32:
    cells = np.stack([keys >> 42, keys >> 21 & (1 << 21) - 1, keys & (1 << 21) - 1], axis=1) - REACH
    return np.asarray((cells + 0.5) * voxel, np.float32)


def _without_specks(points: F32, faces: I64) -> tuple[F32, I64]:
    """Removes small components and unused vertices."""
    if not len(faces):
        return points[:0], faces
    ends = faces[:, :2].T.ravel(), faces[:, 1:].T.ravel()
    links = coo_array((np.ones(len(ends[0]), np.bool_), ends), shape=(len(points), len(points)))
    _, piece = connected_components(links, directed=False)
    sizes = np.bincount(piece[faces[:, 0]], minlength=int(piece.max(initial=-1)) + 1)
    faces = faces[sizes[piece[faces[:, 0]]] >= _LEAST_FACES]
    used, inverse = np.unique(faces, return_inverse=True)
    return points[used], np.asarray(inverse.reshape(-1, 3), np.int64)


def _vertex_normals(points: F32, faces: I64) -> F32:
    """Area-weighted unit vertex normals, float32 [V, 3]."""
    a, b, c = (points[faces[:, corner]].astype(np.float64) for corner in range(3))
    normals = np.cross(b - a, c - a)
    corners = faces.T.ravel()
    sums = [np.bincount(corners, np.tile(normals[:, axis], 3), len(points)) for axis in range(3)]
    summed = np.stack(sums, axis=1)
    return np.asarray(summed / np.maximum(np.linalg.norm(summed, axis=1, keepdims=True), 1e-30), np.float32)
