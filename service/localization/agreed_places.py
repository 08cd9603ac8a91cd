"""Places that photos with known poses agree on, without a scene's surfaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.localization.keypoints import Keypoints, find_keypoints, unit_rows
from fastsplat.service.localization.matching import mutual_matches
from fastsplat.service.localization.projection import reprojected
from fastsplat_contract.camera import PosedCamera

F64 = NDArray[np.float64]

_KEYPOINTS = 2_000
_NEIGHBORS = 5
"""Of a photo, the nearest ones, that it is matched with."""
_LEAST_ANGLE_DEG = 2.0
"""Between two rays: less does not tell a depth."""
_FITS_PX = 2.0


def agreed_places(photos: Sequence[tuple[PosedCamera, NDArray[np.uint8]]]) -> F64:
    """float64 [P, 3], world frame: where the rays of matching keypoints meet, no more than 2 pixels off in both photos.

    Args:
        photos: with their cameras, of the pictures' sizes; uint8 [H, W, 3], RGB.

    Raises:
        CancelledError: see `service.common.cancellation`.
    """
    seen = [find_keypoints(picture, _KEYPOINTS) for _, picture in photos]
    cameras = [posed for posed, _ in photos]
    places = (
        [
            _met(cameras[one], cameras[other], seen[one], seen[other])
            for one, other in _pairs(np.stack([posed.world_from_camera[:3, 3] for posed in cameras]))
        ]
        if len(photos) > 1
        else []
    )
    return np.concatenate([np.zeros((0, 3)), *places])


def _pairs(centers: F64) -> list[tuple[int, int]]:
    away = np.linalg.norm(centers[:, None] - centers, axis=2)
    nearest = np.argsort(away, axis=1, kind="stable")[:, 1 : _NEIGHBORS + 1]
    return sorted({(min(one, other), max(one, other)) for one, row in enumerate(nearest.tolist()) for other in row})


def _met(one: PosedCamera, other: PosedCamera, seen: Keypoints, seen_other: Keypoints) -> F64:
    """float64 [P, 3], the points nearest to both rays of each match."""
    check_cancelled()
    if min(len(seen), len(seen_other)) < 2:
        return np.zeros((0, 3))
    rows, others = mutual_matches(unit_rows(seen.descriptors), unit_rows(seen_other.descriptors))
    pixels = seen.points[rows], seen_other.points[others]
    rays = [_rays(posed, own) for posed, own in zip((one, other), pixels, strict=True)]
    centers = one.world_from_camera[:3, 3], other.world_from_camera[:3, 3]
    across = [np.eye(3) - ray[:, :, None] * ray[:, None, :] for ray in rays]
    right = sum((each @ center for each, center in zip(across, centers, strict=True)), np.zeros(3))
    wide = (rays[0] * rays[1]).sum(axis=1) < np.cos(np.radians(_LEAST_ANGLE_DEG))
    places = np.linalg.solve((across[0] + across[1])[wide], right[wide][:, :, None])[:, :, 0]
    fits = np.ones(len(places), np.bool_)
    for posed, own, ray, center in zip((one, other), pixels, rays, centers, strict=True):
        fits &= np.linalg.norm(reprojected(posed, places) - own[wide], axis=1) < _FITS_PX
        fits &= ((places - center) * ray[wide]).sum(axis=1) > 0
    return places[fits]


def _rays(posed: PosedCamera, pixels: NDArray[np.float32]) -> F64:
    """float64 [K, 3], world frame, of length 1."""
    local = posed.camera.rays(pixels[:, 0].astype(np.float64), pixels[:, 1].astype(np.float64))
    rays = local @ posed.world_from_camera[:3, :3].T
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True), np.float64)
