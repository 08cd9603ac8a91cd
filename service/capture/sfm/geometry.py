"""Validates reconstructions, whose own residual does not tell whether they are right, and normalizes their world."""

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
    "Send 20 to 40 photos of one place, in focus, of things with texture: take a step to the side between one and the "
    "next, so that neighbors overlap by two thirds and show the place from different sides."
)


@dataclass(frozen=True)
class Reconstruction:
    """A reconstruction by structure from motion, as arrays.

    Attributes:
        world_from_camera: float64 [N, 4, 4] of the registered images.
        points: float64 [P, 3].
        angles_deg: float64 [P], widest angle between the rays that see a point.
        images: how many images there were.
        models: sizes of all disconnected reconstructions, largest first; this one is the first.
    """

    world_from_camera: NDArray[np.float64]
    points: NDArray[np.float64]
    angles_deg: NDArray[np.float64]
    images: int
    models: tuple[int, ...]


def validate_reconstruction(
    reconstruction: Reconstruction, *, min_points: int, min_registered_share: float
) -> list[str]:
    """Warnings, as sentences for people, about a reconstruction that can be used.

    Raises:
        ReconstructionError: it cannot: too few images or points, cameras that hardly moved,
            points that collapsed into a plane or into the cameras.
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
    depth = float(np.median(depths(reconstruction.world_from_camera, reconstruction.points)))
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
    """Cameras [N, 4, 4] and points [P, 3] after one similarity, float64: the points' median is the origin, the median
    distance of cameras from it 3, and +z the vertical: `up` [3], else that of `vertical_of_poses` or `mean_up`."""
    rotation = _upright(world_from_camera, up)
    center = np.median(points, axis=0)
    distance = float(np.median(np.linalg.norm(world_from_camera[:, :3, 3] - center, axis=1)))
    scale = _MEDIAN_DISTANCE / distance
    normalized = world_from_camera.copy()
    normalized[:, :3, :3] = rotation @ world_from_camera[:, :3, :3]
    normalized[:, :3, 3] = scale * (world_from_camera[:, :3, 3] - center) @ rotation.T
    return normalized, scale * (points - center) @ rotation.T


def _upright(world_from_camera: NDArray[np.float64], up: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """The smallest rotation that takes the vertical to +z; identity if the poses [N, 4, 4] do not tell it."""
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
    """float64 [N, P]: z of every point in every camera's frame."""
    forward = world_from_camera[:, :3, 2]
    return np.asarray(forward @ points.T - (forward * world_from_camera[:, :3, 3]).sum(axis=1, keepdims=True))


def widest_angle_deg(centers: NDArray[np.float64], point: NDArray[np.float64]) -> float:
    """Widest angle at `point` [3] between the rays to the cameras at `centers` [K, 3]."""
    rays = centers - point
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    return float(np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1.0, 1.0))))


def epipolar_error_px(
    rays1: NDArray[np.float64], rays2: NDArray[np.float64], camera2_from_camera1: NDArray[np.float64], focal: float
) -> NDArray[np.float64]:
    """float64 [M]: Sampson distances in pixels of matched normalized image points under a relative pose.

    Hartley & Zisserman, Multiple View Geometry, eq. 11.9 (its square root).

    Args:
        rays1, rays2: float64 [M, 2], (x/z, y/z).
        camera2_from_camera1: float64 [4, 4].
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
    """How many image pairs match strongly yet contradict the poses, and how many match strongly.

    Args:
        matches: verified matches of each pair of posed images.
        errors_px: median distance of each pair's matches to the epipolar lines of the poses; infinite without poses.
    """
    strong = [error for count, error in zip(matches, errors_px, strict=True) if count >= _MIN_PAIR_MATCHES]
    return sum(not error <= _CONTRADICTION_PX for error in strong), len(strong)


def repetition_warning(wrong: int, strong: int) -> list[str]:
    """A warning when too many pairs contradict the poses of structure from motion, as what repeats makes them."""
    if wrong <= _REPEATING_SHARE * strong:
        return []
    return [
        f"{wrong} of {strong} image pairs that match well contradict the camera poses: if something in the "
        "scene repeats (tiles, wallpaper, twin objects), the geometry may be off by a whole repeat."
    ]


def refuse_wrong_poses(wrong: int, strong: int) -> None:
    """Raise `ReconstructionError` when most pairs contradict the poses of the upload."""
    if wrong > _WRONG_POSES_SHARE * strong:
        raise ReconstructionError(
            f"{wrong} of {strong} image pairs that match well contradict the camera poses",
            limit=f"a share of {_WRONG_POSES_SHARE:g}",
            hint="Check the poses' convention (axes, world-from-camera), intrinsics, and which image has which.",
        )
