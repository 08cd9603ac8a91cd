"""What a scene is known again by: keypoints of its kept photos, at the places on its surfaces that they show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.common.radial_lens import RadialLens
from fastsplat.service.localization.keypoints import DESCRIPTOR_BYTES, Keypoints, find_keypoints
from fastsplat.service.localization.triangulation import SeenKeypoints, triangulate
from fastsplat_contract.camera import PosedCamera

if TYPE_CHECKING:  # torch loads when it is used
    from fastsplat.service.query.drawing.view_geometry import ViewGeometry

MAX_LANDMARK_VIEWS = 300
"""Photos of the scene that are known again; of more, so many are taken, evenly through their order."""
KEYPOINTS_PER_PHOTO = 2_000
"""Places of a photo that are looked for in the scene."""

BYTES_PER_LANDMARK = DESCRIPTOR_BYTES + 3 * 4

_SURE = 0.3
"""Confidence of a depth, see `ViewGeometry`, from which on a keypoint has a place."""
_SMOOTH = 0.04
"""How much the depths beside a keypoint may differ, as a share of them: at the rim of a thing it is on either side."""
_ENOUGH_OTHERS = 2
"""Other photos that show a keypoint where the depth is not sure."""
_INNER = (0.05, 0.95)

Photo = tuple[PosedCamera, Callable[[], NDArray[np.uint8]]]
"""A camera of the scene, and what reads its photo, uint8 [H, W, 3]."""


@dataclass(frozen=True)
class Landmarks:
    """K keypoints of V photos, by photo, within one the strongest first.

    Attributes:
        points: float32 [K, 3], world frame, scene units.
        descriptors: uint8 [K, 128], see `Keypoints`.
        starts: int64 [V + 1]; photo v has the rows starts[v]..starts[v + 1].
        views: names of the photos' cameras.
        size: the scene's, see `scene_size`.
        lens: of the photos; where that is not known, the pinholes that they were undistorted to.
    """

    points: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    starts: NDArray[np.int64]
    views: tuple[str, ...]
    size: float
    lens: RadialLens

    def __post_init__(self) -> None:
        count = len(self.points)
        assert self.points.shape == (count, 3) and self.descriptors.shape == (count, DESCRIPTOR_BYTES)
        assert self.starts.shape == (len(self.views) + 1,) and self.starts[-1] == count

    def __len__(self) -> int:
        return len(self.points)


def find_landmarks(
    photos: Sequence[Photo], geometry: Callable[[PosedCamera], ViewGeometry], lens: RadialLens | None = None
) -> Landmarks:
    """The landmarks of a scene. A keypoint begins with the depth of half the light in the scene's own picture, so that
    any capture has places for it; other photos that show it make it exact (`triangulate`). It is left out where the
    depth is not sure and fewer than two others show it.

    Args:
        photos: of the scene; of more than `MAX_LANDMARK_VIEWS`, so many are used.
        geometry: what a camera sees of the scene.
        lens: of the photos before they were undistorted, if that is known.

    Raises:
        CancelledError: see `service.common.cancellation`.
    """
    rows = np.unique(np.linspace(0, len(photos) - 1, min(len(photos), MAX_LANDMARK_VIEWS)).round().astype(int))
    chosen = [photos[row] for row in rows.tolist()] if photos else []
    seen = [_seen(posed, read(), geometry, KEYPOINTS_PER_PHOTO) for posed, read in chosen]
    points, descriptors, counts = [np.zeros((0, 3), np.float32)], [np.zeros((0, DESCRIPTOR_BYTES), np.uint8)], [0]
    for (photo, sure), (places, others) in zip(seen, triangulate([photo for photo, _ in seen]), strict=True):
        there = np.flatnonzero(sure | (others >= _ENOUGH_OTHERS))
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
) -> tuple[SeenKeypoints, NDArray[np.bool_]]:
    """The keypoints of a photo with the depth that the scene has there, and bool [K], where that is sure."""
    check_cancelled()
    sized = replace(posed, camera=posed.camera.scaled_to(picture.shape[1], picture.shape[0]))
    keypoints = find_keypoints(picture, most)
    seen = geometry(sized)
    height, width = seen.median_depth.shape
    if min(height, width) < 3 or not len(keypoints):
        nothing = Keypoints(np.zeros((0, 2), np.float32), np.zeros((0, DESCRIPTOR_BYTES), np.uint8))
        return SeenKeypoints(sized, nothing, np.zeros(0)), np.zeros(0, np.bool_)
    column = keypoints.points[:, 0].astype(np.intp).clip(1, width - 2)
    row = keypoints.points[:, 1].astype(np.intp).clip(1, height - 2)
    around = np.stack([seen.median_depth[row + y, column + x] for y in (-1, 0, 1) for x in (-1, 0, 1)])
    depth = np.median(around, axis=0).astype(np.float64)
    sure = (
        (around.min(axis=0) > 0) & (np.ptp(around, axis=0) < _SMOOTH * depth) & (seen.confidence[row, column] > _SURE)
    )
    return SeenKeypoints(sized, keypoints, depth), np.asarray(sure)


def scene_size(points: NDArray[np.float32]) -> float:
    """The diagonal of the box that has nine tenths of the points [K, 3] along each axis, scene units; 0 without any."""
    if not len(points):
        return 0.0
    low, high = np.quantile(points.astype(np.float64), _INNER, axis=0)
    return float(np.linalg.norm(high - low))
