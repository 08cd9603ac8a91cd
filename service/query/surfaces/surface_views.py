"""Surfaces seen by a scene's own cameras, and their consensus at points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.scene.artefact.scene import F32
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera

if TYPE_CHECKING:
    from fastsplat.service.query.scene_index import SceneIndex

LEAST_CONFIDENCE = 0.1
"""Pixels below this confidence show no surface.

On a table-top scene with true depth these are 7 % of the pixels, with ten times the depth error of the others."""

BYTES_PER_PIXEL = 19
"""Memory of a `SurfaceView`."""

_AGREEING_VIEWS = 2
_CHUNK = 1 << 17


@dataclass(frozen=True)
class SurfaceView:
    """Surface maps of one camera."""

    posed: PosedCamera  # the camera, scaled to the size of the pictures
    depth: F32  # float32 [H, W], camera z, scene units, 0 where no surface can be relied on
    normals: NDArray[np.float16]  # float16 [H, W, 3], world frame, towards the camera
    confidence: NDArray[np.float16]  # float16 [H, W], 0..1, see `ViewGeometry`
    colors: NDArray[np.uint8]  # uint8 [H, W, 3]
    objects: NDArray[np.uint16]  # uint16 [H, W], ids of objects, 0 for none
    labels: NDArray[np.uint16]  # uint16 [H, W], dictionary ids, 0 for undetected


@dataclass(frozen=True)
class SurfaceSamples:
    """P surface points with the views' consensus."""

    points: F32  # float32 [P, 3], world frame, scene units
    normals: F32  # float32 [P, 3], unit length, or zero where no view sees the point
    colors: NDArray[np.uint8]  # uint8 [P, 3], sRGB
    objects: NDArray[np.uint16]  # uint16 [P], ids of objects, 0 for none
    labels: NDArray[np.uint16]  # uint16 [P], dictionary ids, 0 for undetected
    confidence: F32  # float32 [P], 0..1: mean of the views that see it × their share of those that see (through) it
    views: NDArray[np.int32]  # int32 [P], how many views see the point

    def __len__(self) -> int:
        return len(self.points)

    def where(self, rows: NDArray[np.bool_]) -> SurfaceSamples:
        """Selects `rows`, bool [P]."""
        return SurfaceSamples(**{name: array[rows] for name, array in vars(self).items()})


def surface_cameras(cameras: Sequence[PosedCamera], settings: QuerySettings) -> tuple[PosedCamera, ...]:
    """Samples at most `surface_views` cameras evenly, with at most `surface_side` pixels.

    Raises InvalidInputError for a scene without cameras."""
    if not cameras:
        raise InvalidInputError(
            "a scene without cameras has no views to take its surfaces from",
            field="format",
            hint="Export it as ply, spz or sog, which hold its Gaussians.",
        )
    count = min(len(cameras), settings.surface_views)
    rows = np.unique(np.linspace(0, len(cameras) - 1, count).round().astype(int))
    return tuple(cameras[row].limited_to(settings.surface_side) for row in rows)


def surface_views(index: SceneIndex) -> tuple[SurfaceView, ...]:
    """Renders the surface maps of `surface_cameras`; cancellable."""
    views = []
    for posed in surface_cameras(index.scene.cameras, index.settings):
        check_cancelled()
        seen = index.geometry(posed)
        views.append(
            SurfaceView(
                posed=posed,
                depth=np.where(seen.confidence >= LEAST_CONFIDENCE, seen.median_depth, np.float32(0)),
                normals=seen.normals.astype(np.float16),
                confidence=seen.confidence.astype(np.float16),
                colors=np.asarray((seen.image.clip(0, 1) * 255).round(), np.uint8),
                objects=index.object_map(posed),
                labels=index.label_map(posed),
            )
        )
    return tuple(views)


def back_projected(view: SurfaceView) -> F32:
    """World points of the pixels that have a depth, float32 [K, 3]."""
    rows, columns = np.nonzero(view.depth)
    return view.posed.places(columns + 0.5, rows + 0.5, view.depth[rows, columns]).astype(np.float32)


def projected(view: SurfaceView, points: F32) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Projects points [P, 3] to pixels with depth: rows, flat pixels, camera z, [K]."""
    rows, pixels, depths = view.posed.in_picture(points)
    flat = pixels.astype(np.intp) @ np.array([1, view.posed.camera.width])
    known = view.depth.reshape(-1)[flat] > 0
    return rows[known], flat[known], depths[known]


def observed(points: F32, views: Sequence[SurfaceView], band: float) -> SurfaceSamples:
    """Gathers the views' consensus at points [P, 3]; cancellable.

    A view sees a point whose depth differs from the view's by at most `band` scene units, and sees through a nearer
    one."""
    parts = [_observed(points[start : start + _CHUNK], views, band) for start in range(0, len(points), _CHUNK)]
    if not parts:
        parts = [_observed(points, views, band)]
    return SurfaceSamples(**{name: np.concatenate([vars(part)[name] for part in parts]) for name in vars(parts[0])})


def reliable(samples: SurfaceSamples, views: int) -> NDArray[np.bool_]:
    """Selects points seen by two views (or the only one), and not mostly seen through."""
    return (samples.views >= min(_AGREEING_VIEWS, views)) & (samples.confidence > 0)


def _observed(points: F32, views: Sequence[SurfaceView], band: float) -> SurfaceSamples:
    count = len(points)
    weights, through, seen = np.zeros(count), np.zeros(count, np.int32), np.zeros(count, np.int32)
    colors, normals = np.zeros((count, 3)), np.zeros((count, 3))
    votes: list[tuple[NDArray[np.intp], NDArray[np.uint32], NDArray[np.float32]]] = []
    for view in views:
        check_cancelled()
        rows, pixels, z = projected(view, points)
        ahead = view.depth.reshape(-1)[pixels] - z
        through[rows[ahead > band]] += 1
        near = np.abs(ahead) <= band
        rows, pixels = rows[near], pixels[near]
        weight = view.confidence.reshape(-1)[pixels].astype(np.float32)
        seen[rows] += 1
        weights[rows] += weight
        colors[rows] += weight[:, None] * view.colors.reshape(-1, 3)[pixels]
        normals[rows] += weight[:, None] * view.normals.reshape(-1, 3)[pixels]
        both = view.objects.reshape(-1)[pixels].astype(np.uint32) << np.uint32(16)
        votes.append((rows, both | view.labels.reshape(-1)[pixels], weight))
    winners = _most_voted(votes, count)
    divisor = np.maximum(weights, 1e-9)[:, None]
    lengths = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    agreement = np.where(through > seen, 0.0, seen / np.maximum(seen + through, 1))
    return SurfaceSamples(
        points=points,
        normals=np.asarray(normals / lengths, np.float32),
        colors=np.asarray((colors / divisor).round().clip(0, 255), np.uint8),
        objects=np.asarray(winners >> np.uint32(16), np.uint16),
        labels=np.asarray(winners & np.uint32(0xFFFF), np.uint16),
        confidence=np.asarray(agreement * weights / np.maximum(seen, 1), np.float32),
        views=seen,
    )


def _most_voted(
    votes: Sequence[tuple[NDArray[np.intp], NDArray[np.uint32], NDArray[np.float32]]], count: int
) -> NDArray[np.uint32]:
    """Value with the most weight per row, uint32 [count]; smaller on ties, else 0."""
    winners = np.zeros(count, np.uint32)
    rows = np.concatenate([row for row, _, _ in votes])
    if not len(rows):
        return winners
    keys = rows.astype(np.uint64) << np.uint64(32) | np.concatenate([value for _, value, _ in votes])
    pairs, inverse = np.unique(keys, return_inverse=True)
    sums = np.bincount(inverse, np.concatenate([weight for _, _, weight in votes]))
    order = np.lexsort((-pairs.astype(np.int64), sums))  # the last of a row to be written is the heaviest
    winners[(pairs[order] >> np.uint64(32)).astype(np.intp)] = (pairs[order] & np.uint64(0xFFFFFFFF)).astype(np.uint32)
    return winners
