"""Which triangle each sample of a view shows: exact, and the same on every machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.rooms.shapes import F64, Ints, Mesh
from fastsplat_contract.geometry.camera import Camera

NOTHING = -1
NEAR = 0.03
"""Meters: triangles with a corner nearer than this are not drawn."""

_CHUNK = 2_000_000
_DEEPEST = 2.0**31


@dataclass(frozen=True)
class Soup:
    """All triangles of some meshes.

    Attributes:
        points, normals, local: float64 [N, 3], see `Mesh`.
        uv: float64 [N, 2].
        triangles: int64 [T, 3].
        mesh: int64 [T], the mesh of each.
    """

    points: F64
    normals: F64
    local: F64
    uv: F64
    triangles: Ints
    mesh: Ints


def soup_of(meshes: Sequence[Mesh]) -> Soup:
    """The meshes, at least one, in their order."""
    first = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    return Soup(
        points=np.concatenate([mesh.points for mesh in meshes]),
        normals=np.concatenate([mesh.normals for mesh in meshes]),
        local=np.concatenate([mesh.local for mesh in meshes]),
        uv=np.concatenate([mesh.uv for mesh in meshes]),
        triangles=np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, first, strict=False)]),
        mesh=np.repeat(np.arange(len(meshes)), [len(mesh.triangles) for mesh in meshes]),
    )


@dataclass(frozen=True)
class Hits:
    """What each sample shows.

    Attributes:
        triangle: int64 [H, W], `NOTHING` where there is none.
        nearness: float64 [H, W], the larger the nearer: 1 / depth of a perspective view; 0 where there is nothing.
    """

    triangle: Ints
    nearness: F64


def projected_into(
    soup: Soup, camera: Camera, camera_from_world: F64, steps: int = 1
) -> tuple[F64, NDArray[np.bool_], tuple[int, int]]:
    """What `rasterized` takes of a view: the points, which triangles lie before the camera, rows and columns.

    Args:
        soup: the triangles.
        camera: its samples are `steps` a pixel: with 1 at the centers of pixels, with 2 at their edges as well, so that
            sample [2 r + 1, 2 c + 1] is the center of pixel [r, c].
        camera_from_world: float64 [4, 4], OpenCV axes.
        steps: 1 or 2.
    """
    camera_points = soup.points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
    depth = np.maximum(camera_points[:, 2], 1e-9)
    shift = 0.5 if steps == 1 else 0.0
    x = (camera.fx * camera_points[:, 0] / depth + camera.cx) * steps - shift
    y = (camera.fy * camera_points[:, 1] / depth + camera.cy) * steps - shift
    more = steps - 1
    projected = np.stack([x, y, 1 / np.maximum(camera_points[:, 2], NEAR)], axis=1)
    front = np.all((camera_points[:, 2] > NEAR)[soup.triangles], axis=1)
    return projected, front, (camera.height * steps + more, camera.width * steps + more)


def rasterized(projected: F64, triangles: Ints, drawn: NDArray[np.bool_], size: tuple[int, int]) -> Hits:
    """The nearest triangle at each sample, whole columns and rows; of two that are equally near, the later.

    Args:
        projected: float64 [N, 3]: column, row and nearness (0..1 / `NEAR`), which is linear on the picture.
        triangles: int64 [T, 3].
        drawn: bool [T], which count.
        size: rows and columns.
    """
    height, width = size
    corners = projected[triangles]
    low = np.ceil(corners[:, :, :2].min(axis=1))
    high = np.floor(corners[:, :, :2].max(axis=1))
    low = np.maximum(low, 0)
    high = np.minimum(high, (width - 1, height - 1))
    edge, second_edge = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    area = edge[:, 0] * second_edge[:, 1] - edge[:, 1] * second_edge[:, 0]
    rows = np.flatnonzero(drawn & (high >= low).all(axis=1) & (np.abs(area) > 1e-12))
    spans = (high[rows] - low[rows] + 1).astype(np.int64)
    counts = spans[:, 0] * spans[:, 1]
    planes = _planes(corners[rows], edge[rows], second_edge[rows], area[rows])
    top = max(float(corners[rows, :, 2].max(initial=0)), 1e-12)
    best = np.zeros(height * width, np.uint64)
    chunk = np.cumsum(counts) // _CHUNK
    for number in np.unique(chunk):
        part = np.flatnonzero(chunk == number)
        _draw(best, rows[part], low[rows[part]].astype(np.int64), spans[part], counts[part], planes[part], top, width)
    hit = best > 0
    triangle = np.where(hit, (best & np.uint64(0xFFFFFFFF)).astype(np.int64), NOTHING)
    nearness = np.where(hit, (best >> np.uint64(32)).astype(np.float64) / _DEEPEST * top, 0.0)
    return Hits(triangle.reshape(size), nearness.reshape(size))


def _planes(corners: F64, edge: F64, second_edge: F64, area: F64) -> F64:
    """float64 [T, 3, 3]: the shares of the second and third corner and the nearness, as a x + b y + c."""
    second = np.stack([second_edge[:, 1], -second_edge[:, 0]], axis=1) / area[:, None]
    third = np.stack([-edge[:, 1], edge[:, 0]], axis=1) / area[:, None]
    shares = np.stack([second, third], axis=1)
    constant = -(shares * corners[:, :1, :2]).sum(axis=2)
    shares = np.concatenate([shares, constant[..., None]], axis=2)
    rise = corners[:, 1:, 2] - corners[:, :1, 2]
    near = (rise[..., None] * shares).sum(axis=1)
    near[:, 2] += corners[:, 0, 2]
    return np.concatenate([shares, near[:, None]], axis=1)


def _draw(
    best: NDArray[np.uint64], rows: Ints, low: Ints, spans: Ints, counts: Ints, planes: F64, top: float, width: int
) -> None:
    owner = np.repeat(np.arange(len(rows)), counts)
    place = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
    down = place // spans[owner, 0]
    x, y = low[owner, 0] + place - down * spans[owner, 0], low[owner, 1] + down
    second = planes[owner, 0, 0] * x + planes[owner, 0, 1] * y + planes[owner, 0, 2]
    third = planes[owner, 1, 0] * x + planes[owner, 1, 1] * y + planes[owner, 1, 2]
    inside = np.flatnonzero((second >= 0) & (third >= 0) & (second + third <= 1))
    owner, x, y = owner[inside], x[inside], y[inside]
    near = planes[owner, 2, 0] * x + planes[owner, 2, 1] * y + planes[owner, 2, 2]
    key = np.clip(near / top * _DEEPEST, 1, 2 * _DEEPEST - 1).astype(np.uint64) << np.uint64(32)
    np.maximum.at(best, y * width + x, key | rows[owner].astype(np.uint64))


def corner_shares(projected: F64, corners: Ints, x: F64, y: F64) -> F64:
    """float64 [K, 3]: the shares of a triangle's three corners at samples of it, true in space.

    Args:
        projected: see `rasterized`.
        corners: int64 [K, 3], the points of the triangle at each sample.
        x, y: the sample's column and row.
    """
    a, b, c = (projected[corners[:, k]] for k in range(3))
    edge, second_edge = b[:, :2] - a[:, :2], c[:, :2] - a[:, :2]
    area = edge[:, 0] * second_edge[:, 1] - edge[:, 1] * second_edge[:, 0]
    dx, dy = x - a[:, 0], y - a[:, 1]
    second = (second_edge[:, 1] * dx - second_edge[:, 0] * dy) / area
    third = (edge[:, 0] * dy - edge[:, 1] * dx) / area
    shares = np.stack([1 - second - third, second, third], axis=1)
    shares *= np.stack([a[:, 2], b[:, 2], c[:, 2]], axis=1)
    return np.asarray(shares / shares.sum(axis=1, keepdims=True))
