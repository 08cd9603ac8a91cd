"""Refuses photos that cannot become a scene by their matches, before minutes of mapping.

They share nothing, form groups too small for a scene, or are all from one place: a rotation maps one photo onto another
at any depth (Hartley & Zisserman, 8.4.2).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat.service.capture.sfm.geometry import PHOTO_HINT
from fastsplat.service.capture.sfm.model_agreement import VerifiedMatches
from fastsplat_contract.errors import ReconstructionError

F64 = NDArray[np.float64]

_FOCALS = (0.5, 0.56, 0.63, 0.71, 0.8, 0.92, 1.1, 1.35, 1.8, 2.6)
"""Over the longer side, tried where the focal length is unknown."""
_SAME_PLACE = 0.005
"""Error over the longer side up to which a rotation explains a match, without depth."""
_TURNED = 0.85
"""Share of matches without depth in a pair from one place."""
_ROUNDS = 4
_NEARLY_ALL = 0.8
_FEW = 20  # fewer photos are often too few


def refuse_hopeless(database: Path, *, min_share: float, complete: bool) -> None:
    """Refuses photos that cannot become a scene.

    Args:
        min_share: of the photos that must belong together.
        complete: all pairs were matched; before that, only photos from one place are refused, if nearly all are linked.

    Raises:
        ReconstructionError: the problem of the photos as a whole, with advice.
    """
    verified = VerifiedMatches(database)
    with pycolmap.Database.open(database) as reader:
        images = {image.image_id: image.camera_id for image in reader.read_all_images()}
        cameras = {camera.camera_id: camera for camera in reader.read_all_cameras()}
    count = len(images)
    largest = _largest_group(images, verified.pairs)
    if complete and not verified.pairs:
        raise _refusal(f"no two of the {count} photos show the same object", count)
    if complete and largest < max(2, min_share * count):
        raise _refusal(
            f"the photos show places that have nothing in common: no more than {largest} of {count} belong together",
            count,
            f"a share of {min_share:g}",
        )
    if largest < _NEARLY_ALL * count and not complete:
        return
    for (first, second), rows in verified.pairs.items():
        camera1, camera2 = cameras[images[first]], cameras[images[second]]
        pixels = verified.pixels[first][rows[:, 0]], verified.pixels[second][rows[:, 1]]
        if shows_depth(camera1, camera2, *(part.astype(np.float64) for part in pixels)):
            return
    raise _refusal("all photos were taken from one place: depth cannot be told from photos that only turn", count)


def shows_depth(camera1: pycolmap.Camera, camera2: pycolmap.Camera, pixels1: F64, pixels2: F64) -> bool:
    """Checks that no rotation explains nearly all matches [M, 2] at any possible focal length."""
    known = camera1.has_prior_focal_length and camera2.has_prior_focal_length
    return not any(
        _share_turned(camera1, camera2, pixels1, pixels2, focal) >= _TURNED for focal in (None,) * known or _FOCALS
    )


def _share_turned(
    camera1: pycolmap.Camera, camera2: pycolmap.Camera, pixels1: F64, pixels2: F64, focal: float | None
) -> float:
    """Share of matches that the best rotation explains; `focal` over the longer side, if unknown."""
    rays1, rays2 = _rays(camera1, pixels1, focal), _rays(camera2, pixels2, focal)
    usable = np.isfinite(rays1).all(axis=1) & np.isfinite(rays2).all(axis=1)
    rays1, rays2 = rays1[usable], rays2[usable]
    longer = max(camera2.width, camera2.height)
    allowed = _SAME_PLACE / (focal or camera2.mean_focal_length() / longer)
    inliers = np.ones(len(rays1), bool)
    for _ in range(_ROUNDS):
        left, _, right = np.linalg.svd(rays2[inliers].T @ rays1[inliers])
        rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        angles = np.linalg.norm(rays1 @ rotation.T - rays2, axis=1)
        inliers = angles <= max(allowed, float(np.quantile(angles, 0.7)))
    return float((angles <= allowed).sum() / len(pixels1))


def _rays(camera: pycolmap.Camera, pixels: F64, focal: float | None) -> F64:
    """Unit rays of pixels, float64 [M, 3]."""
    if focal is not None:
        length = focal * max(camera.width, camera.height)
        plane = (pixels - [camera.width / 2, camera.height / 2]) / length
    else:
        plane = np.asarray(camera.cam_from_img(pixels))
    rays = np.column_stack([plane, np.ones(len(plane))])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _largest_group(images: Iterable[int], pairs: Mapping[tuple[int, int], NDArray[np.uint32]]) -> int:
    """Counts the images of the largest group linked by matches."""
    group = {image: image for image in images}

    def head(image: int) -> int:
        while group[image] != image:
            group[image] = group[group[image]]
            image = group[image]
        return image

    for first, second in pairs:
        group[head(first)] = head(second)
    return max(Counter(head(image) for image in group).values())


def _refusal(message: str, count: int, limit: str = "") -> ReconstructionError:
    few = f"{count} photos are few. " if count < _FEW else ""
    return ReconstructionError(message, limit=limit, hint=few + PHOTO_HINT)
