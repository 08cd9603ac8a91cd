"""Validates reconstructions, whose residuals do not show if they are right, and normalizes their world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat.service.common.vertical import mean_up, vertical_of_poses
from fastsplat_contract.errors import ReconstructionError

_MIN_ANGLE_DEG = 1.5
_MIN_FLATNESS = 1e-3
_MAX_DEPTH_TO_BASELINE = 200.0
_MIN_PAIR_MATCHES = 30
_CONTRADICTION_PX = 8.0
_REPEATING_SHARE = 0.15
_WRONG_POSES_SHARE = 0.5
_FEW_REGISTERED = 0.8
_MEDIAN_DISTANCE = 3.0
PHOTO_HINT = (
    "Send 20 to 40 photos of one place, in focus, of objects with texture: take a step to the side between one and the "
    "next, so that neighbors overlap by two thirds and show the place from different sides."
)


@dataclass(frozen=True)
class Reconstruction:
    """A reconstruction by structure from motion."""

    world_from_camera: NDArray[np.float64]  # [N, 4, 4], registered images
    points: NDArray[np.float64]  # [P, 3]
    angles_deg: NDArray[np.float64]  # [P], widest angle between the rays to a point
    images: int  # registered or not
    models: tuple[int, ...]  # sizes of all disconnected reconstructions, largest first; this is the first


def validate_reconstruction(
    reconstruction: Reconstruction, *, min_points: int, min_registered_share: float
) -> list[str]:
    """Checks a reconstruction; returns warnings as sentences for people.

    Raises:
        ReconstructionError: too few images or points, hardly moving cameras, or collapsed points.
    """
    registered, points = len(reconstruction.world_from_camera), len(reconstruction.points)
    if registered < max(2, min_registered_share * reconstruction.images):
        raise ReconstructionError(
            f"only {registered} of {reconstruction.images} images could be registered",
            limit=f"a share of {min_registered_share:g}",
            hint=PHOTO_HINT,
        )
    if points < min_points:
        raise ReconstructionError(
            f"only {points} points are seen by several images", limit=f"{min_points} points", hint=PHOTO_HINT
        )
    _refuse_degenerate(reconstruction)
    warnings = []
    if len(reconstruction.models) > 1:
        sizes = ", ".join(str(size) for size in reconstruction.models)
        warnings.append(
            f"The photos form {len(reconstruction.models)} groups without common views ({sizes} images); only the "
            "largest is used. Photos that overlap with two groups would join them."
        )
    if registered < _FEW_REGISTERED * reconstruction.images:
        warnings.append(
            f"Only {registered} of {reconstruction.images} images could be registered; the others are not used."
        )
    return warnings


def _refuse_degenerate(reconstruction: Reconstruction) -> None:
    centers = reconstruction.world_from_camera[:, :3, 3]
    travel = float(np.linalg.norm(centers.max(axis=0) - centers.min(axis=0)))
    # Of opposite faces of a panorama, depths cancel out.
    depth = float(np.median(np.abs(depths(reconstruction.world_from_camera, reconstruction.points))))
    if np.median(reconstruction.angles_deg) < _MIN_ANGLE_DEG or not 0 < depth < _MAX_DEPTH_TO_BASELINE * travel:
        raise ReconstructionError(
            "the camera hardly moved: depth cannot be told from photos that only turn in place",
            limit=f"a median angle of {_MIN_ANGLE_DEG}° between rays",
            hint=PHOTO_HINT,
        )
    low_end, high_end = np.percentile(reconstruction.points, [1, 99], axis=0)
    core = reconstruction.points[((reconstruction.points >= low_end) & (reconstruction.points <= high_end)).all(axis=1)]
    spread = np.linalg.svd(core - core.mean(axis=0), compute_uv=False) if len(core) > 3 else np.ones(3)
    if spread[2] < _MIN_FLATNESS * spread[0]:
        raise ReconstructionError(
            "all points collapsed into one plane or line: depth cannot be trusted",
            limit=f"a thickness of {_MIN_FLATNESS:g} of the width",
            hint=PHOTO_HINT,
        )


def normalize_world(
    world_from_camera: NDArray[np.float64], points: NDArray[np.float64], up: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Normalizes cameras [N, 4, 4] and points [P, 3] by a similarity.

    The points' median becomes the origin, the cameras' median distance from it 3, and the vertical +z: `up` [3], else
    from `vertical_of_poses` or `mean_up`.
    """
    rotation = _upright(world_from_camera, up)
    center = np.median(points, axis=0)
    distance = float(np.median(np.linalg.norm(world_from_camera[:, :3, 3] - center, axis=1)))
    scale = _MEDIAN_DISTANCE / distance
    normalized = world_from_camera.copy()
    normalized[:, :3, :3] = rotation @ world_from_camera[:, :3, :3]
    normalized[:, :3, 3] = scale * (world_from_camera[:, :3, 3] - center) @ rotation.T
    return normalized, scale * (points - center) @ rotation.T


def _upright(world_from_camera: NDArray[np.float64], up: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Smallest rotation of the vertical to +z; identity if poses do not tell it."""
    for estimate in (vertical_of_poses, mean_up):
        up = estimate(world_from_camera) if up is None else up
    if up is None:
        return np.eye(3)
    if up[2] < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    quaternion = np.array([*np.cross(up, [0.0, 0.0, 1.0]), 1.0 + up[2]])  # x y z w, up to scale
    # pycolmap is loaded anyway; scipy would add 40 MB to every process that builds a capture.
    return np.asarray(pycolmap.Rotation3d(quaternion / np.linalg.norm(quaternion)).matrix())


def depths(world_from_camera: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Depth (z) of every point in every camera, float64 [N, P]."""
    forward = world_from_camera[:, :3, 2]
    return np.asarray(forward @ points.T - (forward * world_from_camera[:, :3, 3]).sum(axis=1, keepdims=True))


def widest_angle_deg(centers: NDArray[np.float64], point: NDArray[np.float64]) -> float:
    """Widest angle at `point` [3] between rays to `centers` [K, 3]."""
    rays = centers - point
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    return float(np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1.0, 1.0))))


def epipolar_error_px(
    rays1: NDArray[np.float64], rays2: NDArray[np.float64], camera2_from_camera1: NDArray[np.float64], focal: float
) -> NDArray[np.float64]:
    """Sampson distances in pixels of matches under a relative pose, float64 [M].

    Square root of eq. 11.9 of Hartley & Zisserman, Multiple View Geometry.

    Args:
        rays1, rays2: [M, 2], normalized image points (x/z, y/z).
        camera2_from_camera1: [4, 4].
        focal: pixels; converts the distance.
    """
    tx, ty, tz = camera2_from_camera1[:3, 3]
    essential = np.array([[0, -tz, ty], [tz, 0, -tx], [-ty, tx, 0]]) @ camera2_from_camera1[:3, :3]
    x1 = np.column_stack([rays1, np.ones(len(rays1))])
    x2 = np.column_stack([rays2, np.ones(len(rays2))])
    line2, line1 = x1 @ essential.T, x2 @ essential
    gradient = (line2[:, :2] ** 2).sum(axis=1) + (line1[:, :2] ** 2).sum(axis=1)
    return np.asarray(focal * np.abs((x2 * line2).sum(axis=1)) / np.sqrt(np.maximum(gradient, 1e-18)))


def contradictions(matches: list[int], errors_px: list[float]) -> tuple[int, int]:
    """Counts strongly matching image pairs that contradict the poses, and all strongly matching pairs.

    Args:
        matches: verified matches of each pair of posed images.
        errors_px: median epipolar distance of each pair's matches; infinite without poses.
    """
    strong = [error for count, error in zip(matches, errors_px, strict=True) if count >= _MIN_PAIR_MATCHES]
    return sum(not error <= _CONTRADICTION_PX for error in strong), len(strong)


def repetition_warning(wrong: int, strong: int) -> list[str]:
    """Warns if too many pairs contradict the poses, as with repeated structures."""
    if wrong <= _REPEATING_SHARE * strong:
        return []
    return [
        f"{wrong} of {strong} image pairs that match well contradict the camera poses: if something in the "
        "scene repeats (tiles, wallpaper, twin objects), the geometry may be off by a whole repeat."
    ]


def refuse_wrong_poses(wrong: int, strong: int) -> None:
    """Raises `ReconstructionError` if most pairs contradict the upload's poses."""
    if wrong > _WRONG_POSES_SHARE * strong:
        raise ReconstructionError(
            f"{wrong} of {strong} image pairs that match well contradict the camera poses",
            limit=f"a share of {_WRONG_POSES_SHARE:g}",
            hint="Check the poses' convention (axes, world-from-camera), intrinsics, and which image has which.",
        )
