"""The pose of a photo from its matches: RANSAC, least squares, and the focal length where nobody says it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat.service.localization.matching import Matches
from fastsplat.service.localization.projection import reprojected
from fastsplat_contract.camera import Camera, PosedCamera
from fastsplat_contract.localize_messages import FocalSource

F64 = NDArray[np.float64]

_ERROR_SHARE = 0.006
"""Of the picture's longer side: as far as an inlier may be from where the pose puts it; places are not exact."""
_TRIALS = 3_000
_CONFIDENCE = 0.9999
_FOCALS = (0.6, 0.75, 0.95, 1.2, 1.6)
"""Tried over the longer side: from a phone's wide angle (0.6) to twice its main camera."""
_SAME_LENS = 0.92
"""With so many of the inliers that the best focal length has, the one of the scene's photos is taken as it is."""
_FEWEST = 6
_FEWEST_FOR_LENS = 80
_EXPLAINED = 0.93
"""As far as the median of the residuals must fall for a distortion to be believed."""
_STRONGEST_LENS = 0.4
_AS_GOOD = 1.3
"""Up to so many times the residuals of the lens that fits best, that of the scene's photos is taken all the same."""


@dataclass(frozen=True)
class SolvedPose:
    """A pose, and what speaks for it.

    Attributes:
        inliers: int64 [N], rows of the matches.
        keypoints: of how many keypoints these are.
    """

    posed: PosedCamera
    inliers: NDArray[np.int64]
    keypoints: int
    focal_source: FocalSource


def error_px(camera: Camera) -> float:
    """As far as an inlier may be from where the pose puts it, pixels."""
    return max(2.0, _ERROR_SHARE * max(camera.width, camera.height))


def solve_pose(
    pixels: F64, points: F64, matches: Matches, size: tuple[int, int], focals: Sequence[tuple[FocalSource, float]]
) -> SolvedPose | None:
    """The pose that most keypoints agree with; None where no pose fits six.

    Args:
        pixels: float64 [M, 2], where the photo shows each match.
        points: float64 [M, 3], where it is in the world.
        matches: the rows of these.
        size: width and height of the photo.
        focals: pixels, the likeliest first. One that is given is taken; otherwise others are tried beside them, and the
            first with which nearly as many keypoints agree as with any is the photo's.
    """
    if len(np.unique(matches.keypoints)) < _FEWEST:
        return None
    tried = list(focals)
    if tried[0][0] != "given":
        tried += [("estimated", share * max(size)) for share in _FOCALS]
    found = [_ransac(pixels, points, matches, pinhole(size, focal), source) for source, focal in tried]
    solved = [one for one in found if one is not None]
    if not solved:
        return None
    most = max(one.keypoints for one in solved)
    best = next(
        one for one in solved if one.keypoints >= (1.0 if one.focal_source == "estimated" else _SAME_LENS) * most
    )
    return refine_pose(pixels, points, matches, best)


def _ransac(pixels: F64, points: F64, matches: Matches, camera: Camera, source: FocalSource) -> SolvedPose | None:
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error = error_px(camera)
    options.ransac.max_num_trials = _TRIALS
    options.ransac.confidence = _CONFIDENCE
    options.ransac.random_seed = 0
    answer = pycolmap.estimate_absolute_pose(pixels, points, colmap_camera(camera), options)
    if answer is None:
        return None
    rows = np.flatnonzero(np.asarray(answer["inlier_mask"], bool)).astype(np.int64)
    posed = PosedCamera(camera, _world_from_camera(answer["cam_from_world"]))
    return SolvedPose(posed, rows, len(np.unique(matches.keypoints[rows])), source)


def refine_pose(pixels: F64, points: F64, matches: Matches, start: SolvedPose) -> SolvedPose | None:
    """Least squares over the inliers of a pose, which are then chosen anew, twice; None where fewer than six agree.

    Args:
        pixels, points, matches: as for `solve_pose`.
        start: with inliers; a focal length that was estimated is refined, too.
    """
    options = pycolmap.AbsolutePoseRefinementOptions()
    options.refine_focal_length = start.focal_source == "estimated"
    options.refine_extra_params = False
    options.print_summary = False
    solved = start
    for _ in range(2):
        mask = np.zeros(len(matches), bool)
        mask[solved.inliers] = True
        camera = colmap_camera(solved.posed.camera)
        viewmat = pycolmap.Rigid3d(solved.posed.camera_from_world()[:3])
        answer = pycolmap.refine_absolute_pose(viewmat, pixels, points, mask, camera, options)
        if answer is None:
            return None
        size = solved.posed.camera.width, solved.posed.camera.height
        refined = pinhole(size, float(camera.params[0]))
        pose = _world_from_camera(answer["cam_from_world"])
        posed = PosedCamera(refined, pose)
        inside = np.linalg.norm(reprojected(posed, points) - pixels, axis=1) < error_px(refined)
        rows = np.flatnonzero(inside).astype(np.int64)
        solved = SolvedPose(posed, rows, len(np.unique(matches.keypoints[rows])), start.focal_source)
        if solved.keypoints < _FEWEST:
            return None
    return solved


def _world_from_camera(viewmat: Any) -> F64:
    pose = np.eye(4)
    pose[:3] = viewmat.inverse().matrix()
    return pose


def radial_distortion(pixels: F64, points: F64, solved: SolvedPose, known: float = 0.0) -> float:
    """The k₁ of a photo's lens by the matches of its pose, x' = x (1 + k₁ r²), beside the scene's undistorted photos; 0
    where too few matches tell, or where it explains hardly anything.

    Args:
        pixels: float64 [M, 2], where the photo shows each match.
        points: float64 [M, 3], where it is in the world.
        known: that of the scene's photos. A photo of their focal length has it, too, unless its matches clearly say
            otherwise: where few places or shallow ones are seen, a distortion explains what a wrong pose explains.
    """
    off = np.linalg.norm(reprojected(solved.posed, points[solved.inliers]) - pixels[solved.inliers], axis=1)
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
    """The median residual of the inliers with the pose that fits a lens best, pixels, and the lens's k₁.

    Args:
        pixels, points, solved: see `radial_distortion`.
        focal, lens: whether the focal length and k₁ are fitted, too.
    """
    rows, before = solved.inliers, solved.posed.camera
    camera = pycolmap.Camera(
        model="SIMPLE_RADIAL", width=before.width, height=before.height, params=[before.fx, before.cx, before.cy, k1]
    )
    options = pycolmap.AbsolutePoseRefinementOptions()
    options.refine_focal_length, options.refine_extra_params, options.print_summary = focal, lens, False
    viewmat = pycolmap.Rigid3d(solved.posed.camera_from_world()[:3])
    mask = np.ones(len(rows), bool)
    answer = pycolmap.refine_absolute_pose(viewmat, pixels[rows], points[rows], mask, camera, options)
    if answer is None:
        return np.inf, 0.0
    local = points[rows] @ answer["cam_from_world"].matrix()[:, :3].T + answer["cam_from_world"].matrix()[:, 3]
    off = np.linalg.norm(camera.img_from_cam(local) - pixels[rows], axis=1)
    return float(np.median(off)), float(camera.params[3])


def undistorted(pixels: F64, camera: Camera, k1: float) -> F64:
    """float64 [M, 2]: where a lens without distortion would have shown what a photo shows at pixels [M, 2]."""
    lens = pycolmap.Camera(
        model="SIMPLE_RADIAL", width=camera.width, height=camera.height, params=[camera.fx, camera.cx, camera.cy, k1]
    )
    straight = np.asarray(lens.cam_from_img(pixels))
    return np.asarray(straight[:, :2] * camera.fx + [camera.cx, camera.cy])


def pinhole(size: tuple[int, int], focal: float) -> Camera:
    """A camera with its axis through the middle of the picture.

    Args:
        size: width and height, pixels.
        focal: pixels.
    """
    return Camera(size[0], size[1], focal, focal, size[0] / 2, size[1] / 2)


def colmap_camera(camera: Camera) -> Any:
    """The same as pycolmap has it, whose pixel centers are at +0.5 as well."""
    return pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=camera.width, height=camera.height, params=[camera.fx, camera.cx, camera.cy]
    )
