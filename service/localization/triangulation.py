"""Triangulates keypoints from the rays of several photos and the scene's own depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.localization.keypoints import Keypoints, unit_rows
from fastsplat.service.localization.projection import reprojected
from fastsplat_contract.geometry.camera import PosedCamera

if TYPE_CHECKING:  # scipy loads when it is used
    from scipy.spatial import cKDTree

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
class SeenKeypoints:
    """The keypoints of a photo with the scene's depths."""

    posed: PosedCamera  # of the photo's size
    keypoints: Keypoints
    depths: F64  # [K], camera z, scene units; 0 where the scene has no surface

    @property
    def places(self) -> F64:
        """World positions, float64 [K, 3]; the camera's center without depth."""
        points = self.keypoints.points
        pose = self.posed.world_from_camera
        local = self.posed.camera.rays(points[:, 0], points[:, 1]) * self.depths[:, None]
        return np.asarray(local @ pose[:3, :3].T + pose[:3, 3])


def triangulate(photos: Sequence[SeenKeypoints]) -> list[tuple[F64, NDArray[np.intp]]]:
    """Triangulates each photo's keypoints.

    Each is searched for in six other photos around its projection by the scene's depth. Its place minimizes the squared
    pixel distances from the rays of all photos and the deviation from that depth, each by its standard deviation. Rays
    more than 3 pixels off are dropped once.

    Returns:
        For each photo the places, float64 [K, 3], and the number of other photos that confirm each, [K].

    Raises:
        CancelledError: see `service.common.cancellation`.
    """
    from scipy.spatial import cKDTree

    trees = [cKDTree(photo.keypoints.points) if len(photo.keypoints) else None for photo in photos]
    units = [unit_rows(photo.keypoints.descriptors) for photo in photos]
    results = []
    for number, photo in enumerate(photos):
        check_cancelled()
        places = photo.places
        seen = []
        for other in _neighbors(photos, number, places):
            tree = trees[other]
            if tree is not None:
                rows = _same(units[number], units[other], tree, reprojected(photos[other].posed, places), photos[other])
                seen.append((other, np.where(photo.depths > 0, rows, -1)))
        first = _solved(photos, number, seen)
        kept = [(other, _fitting(photos[other], rows, first)) for other, rows in seen]
        counts = np.zeros(len(places), np.intp)
        for _, rows in kept:
            counts += rows >= 0
        results.append((_solved(photos, number, kept), counts))
    return results


def _neighbors(photos: Sequence[SeenKeypoints], number: int, places: F64) -> list[int]:
    """Chooses the photos that show most of the same places from another side."""
    rows = np.nonzero(photos[number].depths > 0)[0]
    if not len(rows):
        return []
    sample = places[rows[:: max(1, len(rows) // _SAMPLES)]]
    own = _directions(photos[number].posed, sample)
    scores = np.zeros(len(photos))
    for other, photo in enumerate(photos):
        if other != number:
            shown, camera = reprojected(photo.posed, sample), photo.posed.camera
            inside = (shown >= 0).all(axis=1) & (shown < np.array([camera.width, camera.height])).all(axis=1)
            angles = np.degrees(np.arccos(np.clip((own * _directions(photo.posed, sample)).sum(axis=1), -1, 1)))
            scores[other] = (inside & (angles > _ANGLES_DEG[0]) & (angles < _ANGLES_DEG[1])).sum()
    order = np.argsort(-scores, kind="stable")[:_NEIGHBORS]
    return [int(other) for other in order if scores[other] > 0]


def _same(
    own: NDArray[np.float32], others: NDArray[np.float32], tree: cKDTree, shown: F64, photo: SeenKeypoints
) -> NDArray[np.intp]:
    """Matches each keypoint to one of another photo, [K]; -1 for none."""
    camera = photo.posed.camera
    radius = _RADIUS_SHARE * max(camera.width, camera.height)
    finite = np.asarray(np.isfinite(shown).all(axis=1))
    _, near = tree.query(np.where(finite[:, None], shown, -1e9), k=_NEAREST, distance_upper_bound=radius)
    there = np.asarray(near < len(others))
    alike = np.einsum("kd,knd->kn", own, others[np.where(there, near, 0)])
    alike = np.where(there, alike, -1.0)
    best = alike.argmax(axis=1)
    every = np.arange(len(own))
    highest, winner = alike[every, best], near[every, best]
    alike[every, best] = -1.0
    # A place with two orientations has two keypoints: the second best must be another place.
    clear = (highest > _ALIKE) & (highest - alike.max(axis=1) > _CLEAR)
    return np.asarray(np.where(clear, winner, -1), np.intp)


def _solved(photos: Sequence[SeenKeypoints], number: int, seen: Sequence[tuple[int, NDArray[np.intp]]]) -> F64:
    photo = photos[number]
    depths = np.where(photo.depths > 0, photo.depths, 1.0)
    places = photo.places
    directions = _directions(photo.posed, np.where(photo.depths[:, None] > 0, places, places + np.eye(3)[0]))
    information, vector = _ray_terms(photo, directions, places)
    along = (1 / (_DEPTH_DEVIATION * depths) ** 2)[:, None, None] * directions[:, :, None] * directions[:, None, :]
    information += along
    vector += (along @ places[:, :, None])[:, :, 0]
    for other, rows in seen:
        keypoints = np.flatnonzero(rows >= 0)
        if len(keypoints):
            points = photos[other].keypoints.points[rows[keypoints]]
            pose = photos[other].posed.world_from_camera
            rays = photos[other].posed.camera.rays(points[:, 0], points[:, 1]) @ pose[:3, :3].T
            rays /= np.linalg.norm(rays, axis=1, keepdims=True)
            more, its = _ray_terms(photos[other], rays, places[keypoints])
            information[keypoints] += more
            vector[keypoints] += its
    return np.asarray(np.linalg.solve(information, vector[:, :, None])[:, :, 0])


def _ray_terms(photo: SeenKeypoints, rays: F64, places: F64) -> tuple[F64, F64]:
    """Normal equations of unit rays near places: information [P, 3, 3] and vector [P, 3]."""
    center = photo.posed.world_from_camera[:3, 3]
    away = np.maximum(np.linalg.norm(places - center, axis=1), 1e-9)
    weight = (photo.posed.camera.fx / (away * _DEVIATION_PX)) ** 2
    across = weight[:, None, None] * (np.eye(3) - rays[:, :, None] * rays[:, None, :])
    return across, across @ center


def _fitting(photo: SeenKeypoints, rows: NDArray[np.intp], places: F64) -> NDArray[np.intp]:
    off = np.linalg.norm(reprojected(photo.posed, places) - photo.keypoints.points[np.maximum(rows, 0)], axis=1)
    return np.asarray(np.where((rows >= 0) & (off < _FITS_PX), rows, -1), np.intp)


def _directions(posed: PosedCamera, places: F64) -> F64:
    away = places - posed.world_from_camera[:3, 3]
    return np.asarray(away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12))
