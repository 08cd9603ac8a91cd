"""Landmarks of a scene: keypoints of its photos with places on its surfaces."""

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
from fastsplat_contract.geometry.camera import PosedCamera

if TYPE_CHECKING:  # torch loads when it is used
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
    other photos (`triangulate`). It is dropped if its depth is unsure and fewer than two others show it.

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
    """Detects keypoints with their depths in the scene, and bool [K], where those are sure."""
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
    """Diagonal of the box of the inner 90 % of points per axis, scene units."""
    if not len(points):
        return 0.0
    low, high = np.quantile(points.astype(np.float64), _INNER, axis=0)
    return float(np.linalg.norm(high - low))
