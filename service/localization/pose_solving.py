"""Solves PnP: a photo's pose, focal length and distortion by RANSAC and least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat.service.localization.matching import Matches
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.photos.localization import FocalSource

F64 = NDArray[np.float64]

_ERROR_SHARE = 0.006
"""Inlier error over the picture's longer side; landmarks are not exact."""
_TRIALS = 3_000
_CONFIDENCE = 0.9999
_FOCALS = (0.6, 0.75, 0.95, 1.2, 1.6)
"""Tried over the longer side: phone wide angle (0.6) to twice its main camera."""
_SAME_LENS = 0.92
"""Share of the best focal length's inliers that suffices for the scene photos' one."""
_FEWEST = 6
_FEWEST_FOR_LENS = 80
_EXPLAINED = 0.93
"""Largest share of the residual median that a believable distortion leaves."""
_STRONGEST_LENS = 0.4  # |k₁|
_AS_GOOD = 1.3
"""Factor on the best lens's residuals up to which the scene photos' lens is preferred."""

_ROUGH = 4.0  # times the inlier error of an exact pose, as rough poses move pixels

_MAD = 1.4826  # median of absolute values to standard deviation, normal distribution
_LEAST_PX = 0.3
"""Least keypoint deviation: SIFT is accurate to about a third of a pixel."""
_LEAST_TOLD = 1e-9
_SHARED = 17.0
"""Variance factor for shared errors, covering 95 % of validation photos (docs/measuring.md)."""


@dataclass(frozen=True)
class SolvedPose:
    """A pose with its inliers."""

    posed: PosedCamera
    inliers: NDArray[np.int64]  # [N], rows of the matches
    keypoints: int  # distinct ones among the inliers
    focal_source: FocalSource


def error_px(camera: Camera) -> float:
    """Inlier error in pixels."""
    return max(2.0, _ERROR_SHARE * max(camera.width, camera.height))


def solve_pose(
    pixels: F64, points: F64, matches: Matches, size: tuple[int, int], focals: Sequence[tuple[FocalSource, float]]
) -> SolvedPose | None:
    """Solves the pose with most inlier keypoints; None if no pose fits six.

    Args:
        pixels: [M, 2], each match in the photo.
        points: [M, 3], each match in the world.
        size: width and height of the photo.
        focals: pixels, the likeliest first. If that is not "given", common ones are tried, too; the first with nearly
            the most inlier keypoints wins.
    """
    if len(np.unique(matches.keypoints)) < _FEWEST:
        return None
    tried = list(focals)
    if tried[0][0] != "given":
        tried += [("estimated", share * max(size)) for share in _FOCALS]
    found = [_ransac(pixels, points, matches, pinhole(size, focal), source) for source, focal in tried]
    solved = [pose for pose in found if pose is not None]
    if not solved:
        return None
    most = max(pose.keypoints for pose in solved)
    best = next(
        pose for pose in solved if pose.keypoints >= (1.0 if pose.focal_source == "estimated" else _SAME_LENS) * most
    )
    return refine_pose(pixels, points, matches, best)


def _ransac(pixels: F64, points: F64, matches: Matches, camera: Camera, source: FocalSource) -> SolvedPose | None:
    ransac = {"max_error": error_px(camera), "max_num_trials": _TRIALS, "confidence": _CONFIDENCE, "random_seed": 0}
    options = pycolmap.AbsolutePoseEstimationOptions(ransac=ransac)
    answer = pycolmap.estimate_absolute_pose(pixels, points, colmap_camera(camera), options)
    if answer is None:
        return None
    posed = PosedCamera(camera, _world_from_camera(answer["cam_from_world"]))
    return _with_inliers(posed, np.asarray(answer["inlier_mask"], bool), matches, source)


def _with_inliers(posed: PosedCamera, inside: NDArray[np.bool_], matches: Matches, source: FocalSource) -> SolvedPose:
    rows = np.flatnonzero(inside).astype(np.int64)
    return SolvedPose(posed, rows, len(np.unique(matches.keypoints[rows])), source)


def refine_pose(pixels: F64, points: F64, matches: Matches, start: SolvedPose) -> SolvedPose | None:
    """Refines a pose by least squares over its inliers, selected anew twice.

    None if fewer than six keypoints remain.

    Args:
        pixels, points, matches: as for `solve_pose`.
        start: its focal length is refined, too, if it was estimated.
    """
    options, solved = _refinement(focal=start.focal_source == "estimated"), start
    for _ in range(2):
        mask = np.zeros(len(matches), bool)
        mask[solved.inliers] = True
        camera = colmap_camera(solved.posed.camera)
        viewmat = pycolmap.Rigid3d(solved.posed.camera_from_world()[:3])
        answer = pycolmap.refine_absolute_pose(viewmat, pixels, points, mask, camera, options)
        if answer is None:
            return None
        size = solved.posed.camera.width, solved.posed.camera.height
        posed = PosedCamera(pinhole(size, float(camera.params[0])), _world_from_camera(answer["cam_from_world"]))
        inside = np.linalg.norm(posed.pixels(points) - pixels, axis=1) < error_px(posed.camera)
        solved = _with_inliers(posed, inside, matches, start.focal_source)
        if solved.keypoints < _FEWEST:
            return None
    return solved


def _refinement(*, focal: bool, lens: bool = False) -> pycolmap.AbsolutePoseRefinementOptions:
    return pycolmap.AbsolutePoseRefinementOptions(
        refine_focal_length=focal, refine_extra_params=lens, print_summary=False
    )


def _world_from_camera(viewmat: Any) -> F64:
    pose = np.eye(4)
    pose[:3] = viewmat.inverse().matrix()
    return pose


def radial_distortion(pixels: F64, points: F64, solved: SolvedPose, known: float = 0.0) -> float:
    """Estimates k₁ of a photo's lens from its inliers: x' = x (1 + k₁ r²).

    0 if there are too few inliers or it explains hardly anything; the scene's points are free of distortion.

    Args:
        pixels: [M, 2], each match in the photo.
        points: [M, 3], each match in the world.
        known: k₁ of the scene's photos, used for a photo of their focal length unless its matches clearly contradict:
            with few or shallow points, distortion explains what a wrong pose explains.
    """
    off = np.linalg.norm(solved.posed.pixels(points[solved.inliers]) - pixels[solved.inliers], axis=1)
    best, k1 = float(np.median(off)), 0.0
    if solved.keypoints >= _FEWEST_FOR_LENS:
        free = solved.focal_source in ("scene", "estimated")
        error, found = _with_lens(pixels, points, solved, 0.0, focal=free, lens=True)
        if error < _EXPLAINED * best and abs(found) < _STRONGEST_LENS:
            best, k1 = error, found
    if known and solved.focal_source == "scene":
        error, _ = _with_lens(pixels, points, solved, known, focal=False, lens=False)
        if error < _AS_GOOD * best:
            return known
    return k1


def _with_lens(
    pixels: F64, points: F64, solved: SolvedPose, k1: float, *, focal: bool, lens: bool
) -> tuple[float, float]:
    """Fits the pose, and `focal` length and `lens` if so; the inliers' median residual in pixels, and k₁."""
    rows, camera = solved.inliers, colmap_camera(solved.posed.camera, k1)
    options = _refinement(focal=focal, lens=lens)
    viewmat = pycolmap.Rigid3d(solved.posed.camera_from_world()[:3])
    mask = np.ones(len(rows), bool)
    answer = pycolmap.refine_absolute_pose(viewmat, pixels[rows], points[rows], mask, camera, options)
    if answer is None:
        return np.inf, 0.0
    local = points[rows] @ answer["cam_from_world"].matrix()[:, :3].T + answer["cam_from_world"].matrix()[:, 3]
    off = np.linalg.norm(camera.img_from_cam(local) - pixels[rows], axis=1)
    return float(np.median(off)), float(camera.params[3])


def undistorted(pixels: F64, camera: Camera, k1: float) -> F64:
    """Removes the distortion k₁ from pixels [M, 2]; float64 [M, 2]."""
    straight = np.asarray(colmap_camera(camera, k1).cam_from_img(pixels))
    return np.asarray(straight[:, :2] * camera.fx + [camera.cx, camera.cy])


def pinhole(size: tuple[int, int], focal: float) -> Camera:
    """Makes a camera with a centered principal point; size as (width, height), pixels."""
    return Camera(size[0], size[1], focal, focal, size[0] / 2, size[1] / 2)


def colmap_camera(camera: Camera, *k1: float) -> Any:
    """Converts to pycolmap, whose pixel centers are at +0.5, too; with distortion `k1` if there is any."""
    model, params = "SIMPLE_RADIAL" if k1 else "SIMPLE_PINHOLE", [camera.fx, camera.cx, camera.cy, *k1]
    return pycolmap.Camera(model=model, width=camera.width, height=camera.height, params=params)


def solve_jointly(
    pixels: Sequence[F64],
    points: Sequence[F64],
    matches: Sequence[Matches],
    cameras: Sequence[tuple[FocalSource, Camera]],
    rough: Sequence[F64],
) -> tuple[SolvedPose | None, ...]:
    """Solves one pose for a rigid group by generalized RANSAC, then refines each photo's own.

    A photo with too few matches keeps the group's pose; all are None if no pose fits the group.

    Args:
        pixels, points, matches: of each photo, as for `solve_pose`.
        cameras: of each photo, with the source of the focal length.
        rough: [4, 4] each: rough_frame_from_camera, rigid, scene units.
    """
    rows = np.concatenate([np.full(len(photo_matches), number) for number, photo_matches in enumerate(matches)])
    if len(rows) < _FEWEST:
        return (None,) * len(matches)
    error = _ROUGH * max(error_px(camera) for _, camera in cameras)
    options = pycolmap.RANSACOptions(max_error=error, max_num_trials=_TRIALS, min_num_trials=100, random_seed=0)
    answer = pycolmap.estimate_and_refine_generalized_absolute_pose(
        np.concatenate(pixels),
        np.concatenate(points),
        rows.tolist(),
        [pycolmap.Rigid3d(np.linalg.inv(pose)[:3]) for pose in rough],
        [colmap_camera(camera) for _, camera in cameras],
        options,
        _refinement(focal=False),
    )
    if answer is None:
        return (None,) * len(matches)
    world_from_rough = np.eye(4)
    world_from_rough[:3] = answer["rig_from_world"].inverse().matrix()
    solved = []
    for number, (source, camera) in enumerate(cameras):
        posed = PosedCamera(camera, world_from_rough @ rough[number])
        off = np.linalg.norm(posed.pixels(points[number]) - pixels[number], axis=1)
        start = _with_inliers(posed, off < _ROUGH * error_px(camera), matches[number], source)
        solution = (
            refine_pose(pixels[number], points[number], matches[number], start) if start.keypoints >= _FEWEST else None
        )
        solved.append(solution or start)
    return tuple(solved)


def pose_covariance(posed: PosedCamera, pixels: F64, points: F64, *, focal_estimated: bool) -> F64:
    """Estimates the covariance of a pose, float64 [6, 6].

    Ordered as in geometry_msgs/PoseWithCovariance: x, y, z of the camera's center (scene units) and small rotations
    about the world's axes x, y, z (radians). σ² (JᵀJ)⁻¹ over the matches, with the focal length if estimated; σ by
    the median residual (Hartley and Zisserman, 5.2.3), times √17 for shared errors.

    Args:
        pixels: [N, 2], inliers in the photo, N ≥ 4, in front of the camera.
        points: [N, 3], inliers in the world.
        focal_estimated: the focal length comes from these matches.
    """
    jacobian, local = _pose_jacobian(posed, points)
    x, y, z = local.T
    if focal_estimated:
        by_focal = np.stack([x / z, y / z], axis=1)[:, :, None]
        jacobian = np.concatenate([jacobian, by_focal], axis=2)
    residuals = (pixels - posed.pixels(points)).ravel()
    deviation = max(_LEAST_PX, _MAD * float(np.median(np.abs(residuals))))
    rows = jacobian.reshape(-1, jacobian.shape[2])
    lengths = np.maximum(np.linalg.norm(rows, axis=0), 1e-12)
    values, vectors = np.linalg.eigh((rows / lengths).T @ (rows / lengths))
    # A direction that the matches do not constrain gets a large variance.
    inverse = (vectors / np.maximum(values, _LEAST_TOLD)) @ vectors.T / np.outer(lengths, lengths)
    return np.asarray(_SHARED * deviation**2 * inverse[:6, :6])


def shown_deviation(posed: PosedCamera, points: F64, covariance: F64) -> float:
    """RMS deviation in pixels of projected points [N, 3] under a pose covariance; focal exact."""
    jacobian, _ = _pose_jacobian(posed, points)
    return float(np.sqrt(np.einsum("nki,ij,nkj->nk", jacobian, covariance, jacobian).mean()))


def _pose_jacobian(posed: PosedCamera, points: F64) -> tuple[F64, F64]:
    """Jacobian of pixels, [N, 2, 6], columns as in `pose_covariance`; points in the camera's frame, [N, 3]."""
    pose, camera = posed.world_from_camera, posed.camera
    away = points - pose[:3, 3]
    local = away @ pose[:3, :3]
    x, y, z = local.T
    zero = np.zeros_like(z)
    across = np.stack([camera.fx / z, zero, -camera.fx * x / z**2], axis=1)
    down = np.stack([zero, camera.fy / z, -camera.fy * y / z**2], axis=1)
    moved = np.stack([across, down], axis=1)
    turn = pose[:3, :3].T
    # p = Rᵀ (X - t): by t it moves by -Rᵀ, by exp(ω) R about the world's axes by Rᵀ [X - t]ₓ.
    by_rotation = np.cross(turn, away[:, None])
    return np.concatenate([-moved @ turn, moved @ by_rotation], axis=2), local
