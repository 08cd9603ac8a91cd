"""Landmarks of a scene: keypoints of its photos with places on its surfaces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.common.radial_lens import RadialLens
from fastsplat.service.localization.keypoints import (
    DESCRIPTOR_BYTES,
    NO_KEYPOINTS,
    Keypoints,
    find_keypoints,
    unit_rows,
)
from fastsplat_contract.geometry.camera import PosedCamera

if TYPE_CHECKING:  # torch loads when it is used
    from scipy.spatial import cKDTree

    from fastsplat.service.query.drawing.view_geometry import ViewGeometry


MAX_LANDMARK_VIEWS = 300
"""Photos with landmarks; of more, a subset evenly spaced in order."""
KEYPOINTS_PER_PHOTO = 2_000

BYTES_PER_LANDMARK = DESCRIPTOR_BYTES + 3 * 4

_SURE = 0.3
"""Depth confidence (`ViewGeometry`) from which on a keypoint is placed by it alone."""
_SMOOTH = 0.04
"""Largest relative depth difference around a keypoint; beyond, it lies on an object's edge."""
_ENOUGH_OTHERS = 2
"""Other photos that must confirm a keypoint whose depth is not sure."""
_INNER = (0.05, 0.95)

Photo = tuple[PosedCamera, Callable[[], NDArray[np.uint8]]]
"""A camera of the scene, and a loader of its photo, uint8 [H, W, 3]."""

F64 = NDArray[np.float64]

_NEIGHBORS = 6
_SAMPLES = 100
_ANGLES_DEG = (2.0, 40.0)
"""Limits of the angle between two rays: less gives no depth, more is beyond SIFT."""
_RADIUS_SHARE = 0.02
"""Search radius around the projection by the scene's depth, over the picture's longer side."""
_NEAREST = 6
_ALIKE = 0.85
"""Least similarity, as dot product of unit descriptors, of the same place."""
_CLEAR = 0.03  # least margin in similarity to other keypoints nearby
_DEVIATION_PX = 1.0
_FITS_PX = 3.0
_DEPTH_DEVIATION = 0.04
"""Deviation of the scene's own depth, relative; see docs/measuring.md."""


@dataclass(frozen=True)
class Landmarks:
    """K keypoints of V photos, ordered by photo, then by strength."""

    points: NDArray[np.float32]  # [K, 3], world frame, scene units
    descriptors: NDArray[np.uint8]  # [K, 128], see `Keypoints`
    starts: NDArray[np.int64]  # [V + 1]; photo v has the rows starts[v]..starts[v + 1]
    views: tuple[str, ...]  # names of the photos' cameras
    size: float  # see `scene_size`
    lens: RadialLens  # of the original photos, or of the undistorted ones if that is unknown

    def __post_init__(self) -> None:
        count = len(self.points)
        assert self.points.shape == (count, 3) and self.descriptors.shape == (count, DESCRIPTOR_BYTES)
        assert self.starts.shape == (len(self.views) + 1,) and self.starts[-1] == count

    def __len__(self) -> int:
        return len(self.points)


def find_landmarks(
    photos: Sequence[Photo], geometry: Callable[[PosedCamera], ViewGeometry], lens: RadialLens | None = None
) -> Landmarks:
    """Finds the landmarks of a scene.

    A keypoint starts at the median depth of the scene's rendering, so that any capture can place it, and is refined by
    other photos (`_triangulate`). It is dropped if its depth is unsure and fewer than two others show it.

    Args:
        geometry: renders what a camera sees of the scene.
        lens: of the photos before undistortion, if known.

    Raises:
        CancelledError: see `service.common.cancellation`.
    """
    rows = np.unique(np.linspace(0, len(photos) - 1, min(len(photos), MAX_LANDMARK_VIEWS)).round().astype(int))
    chosen = [photos[row] for row in rows.tolist()] if photos else []
    seen = [_seen(posed, read(), geometry, KEYPOINTS_PER_PHOTO) for posed, read in chosen]
    points, descriptors, counts = [np.zeros((0, 3), np.float32)], [np.zeros((0, DESCRIPTOR_BYTES), np.uint8)], [0]
    for (photo, sure), (places, witnesses) in zip(seen, _triangulate([photo for photo, _ in seen]), strict=True):
        there = np.flatnonzero(sure | (witnesses >= _ENOUGH_OTHERS))
        points.append(places[there].astype(np.float32))
        descriptors.append(photo.keypoints.descriptors[there])
        counts.append(len(there))
    every = np.concatenate(points)
    focals = [
        max(posed.camera.fx, posed.camera.fy) / max(posed.camera.width, posed.camera.height) for posed, _ in chosen
    ]
    return Landmarks(
        every,
        np.concatenate(descriptors),
        np.cumsum(counts).astype(np.int64),
        tuple(posed.name for posed, _ in chosen),
        scene_size(every),
        lens or RadialLens(float(np.median(focals)) if focals else 1.0, 0.0),
    )


def _seen(
    posed: PosedCamera, picture: NDArray[np.uint8], geometry: Callable[[PosedCamera], ViewGeometry], most: int
) -> tuple[_SeenKeypoints, NDArray[np.bool_]]:
    """Detects keypoints with their depths in the scene, and bool [K], where those are sure."""
    check_cancelled()
    sized = replace(posed, camera=posed.camera.scaled_to(picture.shape[1], picture.shape[0]))
    keypoints = find_keypoints(picture, most)
    seen = geometry(sized)
    height, width = seen.median_depth.shape
    if min(height, width) < 3 or not len(keypoints):
        return _SeenKeypoints(sized, NO_KEYPOINTS, np.zeros(0)), np.zeros(0, np.bool_)
    column = keypoints.points[:, 0].astype(np.intp).clip(1, width - 2)
    row = keypoints.points[:, 1].astype(np.intp).clip(1, height - 2)
    around = np.stack([seen.median_depth[row + y, column + x] for y in (-1, 0, 1) for x in (-1, 0, 1)])
    depth = np.median(around, axis=0).astype(np.float64)
    sure = (
        (around.min(axis=0) > 0) & (np.ptp(around, axis=0) < _SMOOTH * depth) & (seen.confidence[row, column] > _SURE)
    )
    return _SeenKeypoints(sized, keypoints, depth), np.asarray(sure)


def scene_size(points: NDArray[np.float32]) -> float:
    """Diagonal of the box of the inner 90 % of points per axis, scene units."""
    if not len(points):
        return 0.0
    low, high = np.quantile(points.astype(np.float64), _INNER, axis=0)
    return float(np.linalg.norm(high - low))


@dataclass(frozen=True)
class _SeenKeypoints:
    """The keypoints of a photo with the scene's depths."""

    posed: PosedCamera  # of the photo's size
    keypoints: Keypoints
    depths: F64  # [K], camera z, scene units; 0 where the scene has no surface

    @property
    def places(self) -> F64:
        """World positions, float64 [K, 3]; the camera's center without depth."""
        x, y = self.keypoints.points.T
        return self.posed.places(x, y, self.depths)


def _triangulate(photos: Sequence[_SeenKeypoints]) -> list[tuple[F64, NDArray[np.intp]]]:
    """For each photo its keypoints' places, float64 [K, 3], and how many others confirm each, [K]."""
    # Each is searched for in six other photos around its projection by the scene's depth. Its place minimizes the
    # squared pixel distances from the rays of all photos and the deviation from that depth, each by its standard
    # deviation. Rays more than 3 pixels off are dropped once.
    from scipy.spatial import cKDTree

    trees = [cKDTree(photo.keypoints.points) if len(photo.keypoints) else None for photo in photos]
    units = [unit_rows(photo.keypoints.descriptors) for photo in photos]
    results = []
    for number, photo in enumerate(photos):
        check_cancelled()
        places = photo.places
        seen = []
        for peer in _neighbors(photos, number, places):
            tree = trees[peer]
            if tree is not None:
                rows = _same(units[number], units[peer], tree, photos[peer].posed.pixels(places), photos[peer])
                seen.append((peer, np.where(photo.depths > 0, rows, -1)))
        first = _solved(photos, number, seen)
        inliers, counts = [], np.zeros(len(places), np.intp)
        for peer, rows in seen:
            points = photos[peer].keypoints.points[np.maximum(rows, 0)]
            off = np.linalg.norm(photos[peer].posed.pixels(first) - points, axis=1)
            fits = (rows >= 0) & (off < _FITS_PX)
            inliers.append((peer, np.where(fits, rows, -1)))
            counts += fits
        results.append((_solved(photos, number, inliers), counts))
    return results


def _neighbors(photos: Sequence[_SeenKeypoints], number: int, places: F64) -> list[int]:
    """Chooses the photos that show most of the same places from another side."""
    rows = np.nonzero(photos[number].depths > 0)[0]
    if not len(rows):
        return []
    sample = places[rows[:: max(1, len(rows) // _SAMPLES)]]
    rays = _directions(photos[number].posed, sample)
    scores = np.zeros(len(photos))
    for peer, photo in enumerate(photos):
        if peer != number:
            rows, _, _ = photo.posed.in_picture(sample)
            angles = np.degrees(np.arccos(np.clip((rays * _directions(photo.posed, sample)).sum(axis=1), -1, 1)))
            scores[peer] = ((angles > _ANGLES_DEG[0]) & (angles < _ANGLES_DEG[1]))[rows].sum()
    order = np.argsort(-scores, kind="stable")[:_NEIGHBORS]
    return [int(peer) for peer in order if scores[peer] > 0]


def _same(
    units: NDArray[np.float32], other_units: NDArray[np.float32], tree: cKDTree, pixels: F64, photo: _SeenKeypoints
) -> NDArray[np.intp]:
    """Matches each keypoint to one of another photo, [K]; -1 for none."""
    camera = photo.posed.camera
    radius = _RADIUS_SHARE * max(camera.width, camera.height)
    finite = np.asarray(np.isfinite(pixels).all(axis=1))
    _, near = tree.query(np.where(finite[:, None], pixels, -1e9), k=_NEAREST, distance_upper_bound=radius)
    there = np.asarray(near < len(other_units))
    alike = np.einsum("kd,knd->kn", units, other_units[np.where(there, near, 0)])
    alike = np.where(there, alike, -1.0)
    best = alike.argmax(axis=1)
    every = np.arange(len(units))
    highest, winner = alike[every, best], near[every, best]
    alike[every, best] = -1.0
    # A place with two orientations has two keypoints: the second best must be another place.
    clear = (highest > _ALIKE) & (highest - alike.max(axis=1) > _CLEAR)
    return np.asarray(np.where(clear, winner, -1), np.intp)


def _solved(photos: Sequence[_SeenKeypoints], number: int, seen: Sequence[tuple[int, NDArray[np.intp]]]) -> F64:
    photo = photos[number]
    depths = np.where(photo.depths > 0, photo.depths, 1.0)
    places = photo.places
    directions = _directions(photo.posed, np.where(photo.depths[:, None] > 0, places, places + np.eye(3)[0]))
    information, vector = _ray_terms(photo, directions, places)
    along = (1 / (_DEPTH_DEVIATION * depths) ** 2)[:, None, None] * directions[:, :, None] * directions[:, None, :]
    information += along
    vector += (along @ places[:, :, None])[:, :, 0]
    for peer, rows in seen:
        keypoints = np.flatnonzero(rows >= 0)
        if len(keypoints):
            points = photos[peer].keypoints.points[rows[keypoints]]
            pose = photos[peer].posed.world_from_camera
            rays = photos[peer].posed.camera.rays(points[:, 0], points[:, 1]) @ pose[:3, :3].T
            rays /= np.linalg.norm(rays, axis=1, keepdims=True)
            more, its = _ray_terms(photos[peer], rays, places[keypoints])
            information[keypoints] += more
            vector[keypoints] += its
    return np.asarray(np.linalg.solve(information, vector[:, :, None])[:, :, 0])


def _ray_terms(photo: _SeenKeypoints, rays: F64, places: F64) -> tuple[F64, F64]:
    """Normal equations of unit rays near places: information [P, 3, 3] and vector [P, 3]."""
    center = photo.posed.world_from_camera[:3, 3]
    away = np.maximum(np.linalg.norm(places - center, axis=1), 1e-9)
    weight = (photo.posed.camera.fx / (away * _DEVIATION_PX)) ** 2
    across = weight[:, None, None] * (np.eye(3) - rays[:, :, None] * rays[:, None, :])
    return across, across @ center


def _directions(posed: PosedCamera, places: F64) -> F64:
    away = places - posed.world_from_camera[:3, 3]
    return np.asarray(away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12))
