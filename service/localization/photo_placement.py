"""Visual localization of photos: features, matches, pose, refinement, acceptance, covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.localization.acceptance import FEWEST_KEYPOINTS, Evidence, agreement_of, refusal_of, spread_of
from fastsplat.service.localization.keypoints import find_keypoints
from fastsplat.service.localization.landmarks import KEYPOINTS_PER_PHOTO, Landmarks
from fastsplat.service.localization.matching import Matches, find_matches
from fastsplat.service.localization.photometric_refinement import (
    COMPARED_SIDE,
    COMPARISON_DEVIATION_PX,
    Comparison,
    Geometry,
    compared,
    refine_photometrically,
)
from fastsplat.service.localization.pose_solving import (
    SolvedPose,
    error_px,
    pinhole,
    pose_covariance,
    radial_distortion,
    refine_pose,
    shown_deviation,
    solve_jointly,
    solve_pose,
    undistorted,
)
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.photos.localization import FocalSource, LocalizeRefusal

_MATCHED_VIEWS = 8  # most similar photos of the scene that are matched in full

F64 = NDArray[np.float64]

_NOTHING = Evidence(0, 0.0, 0.0, None)
_KEPT_INLIERS = 0.8
"""Share of the inliers that photometric refinement must keep."""
_FEWEST_OF_GROUP = 6  # a photo's own keypoints, from which its covariance is computed


@dataclass(frozen=True)
class Photo:
    """A photo to be placed."""

    picture: NDArray[np.uint8]  # [H, W, 3], upright, undistorted as far as known
    focal: float | None = None  # over the longer side
    focal_source: FocalSource = "given"  # or "metadata"
    valid: NDArray[np.bool_] | None = None  # [H, W]; None: everywhere

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.picture.shape[1], self.picture.shape[0]


@dataclass(frozen=True)
class PlacedPhoto:
    """Result for a photo; everything about its pose is None where it is refused."""

    refusal: LocalizeRefusal | None
    evidence: Evidence
    posed: PosedCamera | None = None  # of the picture's size
    covariance: F64 | None = None  # [6, 6], see `pose_covariance`
    focal_source: FocalSource = "scene"
    refined: bool = False  # photometric refinement improved the pose
    comparison: Comparison | None = None
    radial: float = 0.0  # k₁ that was undone, see `radial_distortion`
    photo: Photo | None = None  # undistorted


@dataclass(frozen=True)
class _Matched:
    """A photo and its matches; `k1` is of the lens of the scene's photos."""

    photo: Photo
    keypoints: int
    matches: Matches
    pixels: F64
    points: F64
    focals: tuple[tuple[FocalSource, float], ...]
    k1: float


def place_photos(
    photos: Sequence[Photo], landmarks: Landmarks, geometry: Geometry, rough: Sequence[F64] = ()
) -> tuple[PlacedPhoto, ...]:
    """Places photos in a scene.

    Args:
        photos: placed one by one, or as a group if there are rough poses.
        geometry: renders what a camera sees of the scene.
        rough: [4, 4] of each photo: frame_from_camera in any frame of scene units; empty if unknown.

    Raises:
        CancelledError: see `service.common.cancellation`.
    """
    matched = []
    for photo in photos:
        check_cancelled()
        matched.append(_match(photo, landmarks))
    alone = [solve_pose(match.pixels, match.points, match.matches, match.photo.size, match.focals) for match in matched]
    solved: Sequence[SolvedPose | None] = alone
    if rough:
        cameras = [
            (match.focals[0][0], pinhole(match.photo.size, match.focals[0][1]))
            if pose is None
            else (pose.focal_source, pose.posed.camera)
            for match, pose in zip(matched, alone, strict=True)
        ]
        pixels, points, matches = zip(*((match.pixels, match.points, match.matches) for match in matched), strict=True)
        together = solve_jointly(pixels, points, matches, cameras, rough)
        solved = [group or pose for group, pose in zip(together, alone, strict=True)]
        inliers = sum(pose.keypoints for pose in together if pose is not None)
    placed = []
    for match, pose in zip(matched, solved, strict=True):
        check_cancelled()
        placed.append(_placed(match, pose, geometry, inliers if rough and pose is not None else None))
    return tuple(placed)


def _match(photo: Photo, landmarks: Landmarks) -> _Matched:
    keypoints = find_keypoints(photo.picture, KEYPOINTS_PER_PHOTO)
    matches = find_matches(landmarks, keypoints, _MATCHED_VIEWS)
    longer = max(photo.size)
    focals: list[tuple[FocalSource, float]] = []
    if photo.focal is not None:
        focals.append((photo.focal_source, photo.focal * longer))
    focals.append(("scene", landmarks.lens.focal * longer))
    pixels = keypoints.points[matches.keypoints].astype(np.float64)
    points = landmarks.points[matches.landmarks].astype(np.float64)
    return _Matched(photo, len(keypoints), matches, pixels, points, tuple(focals), landmarks.lens.k1)


def _placed(match: _Matched, pose: SolvedPose | None, geometry: Geometry, of_group: int | None) -> PlacedPhoto:
    """Refines and judges a pose; `of_group`: inlier keypoints of all photos of its group."""
    if match.keypoints < FEWEST_KEYPOINTS and of_group is None:
        return PlacedPhoto("no_keypoints", _NOTHING)
    if pose is None or pose.keypoints < _FEWEST_OF_GROUP:
        return PlacedPhoto("few_matches", _NOTHING)
    matched = len(np.unique(match.matches.keypoints))
    spread = spread_of(match.pixels[pose.inliers], match.photo.size)
    evidence = Evidence(pose.keypoints, pose.keypoints / max(matched, 1), spread, None)
    counted = evidence if of_group is None else replace(evidence, inliers=of_group, spread=1.0)
    if (refusal := refusal_of(replace(counted, agreement=1.0))) is not None:
        return PlacedPhoto(refusal, evidence)
    match, pose, radial = _straightened(match, pose)
    rows = pose.inliers
    estimated = pose.focal_source != "given"  # metadata and other photos may be a few percent off
    covariance = pose_covariance(pose.posed, match.pixels[rows], match.points[rows], focal_estimated=estimated)
    posed, comparison, refined = _refined(match, pose, covariance, geometry)
    agreement = agreement_of(comparison)
    evidence = replace(evidence, agreement=agreement)
    if (refusal := refusal_of(replace(counted, agreement=agreement))) is not None:
        return PlacedPhoto(refusal, evidence)
    return PlacedPhoto(None, evidence, posed, covariance, pose.focal_source, refined, comparison, radial, match.photo)


def _straightened(match: _Matched, pose: SolvedPose) -> tuple[_Matched, SolvedPose, float]:
    """Undistorts photo and matches, solves the pose again, and returns k₁; 0 if unchanged."""
    radial = radial_distortion(match.pixels, match.points, pose, match.k1)
    if not radial:
        return match, pose, 0.0
    camera = pose.posed.camera
    pixels = undistorted(match.pixels, camera, radial)
    straight = refine_pose(pixels, match.points, match.matches, pose)
    if straight is None:
        return match, pose, 0.0
    # OpenCV's pixel centers are whole numbers.
    matrix = np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1.0]])
    lens, whole = np.array([radial, 0.0, 0.0, 0.0]), np.full(match.photo.picture.shape[:2], 255, np.uint8)
    picture, valid = (np.asarray(cv2.undistort(part, matrix, lens), np.uint8) for part in (match.photo.picture, whole))
    photo = replace(match.photo, picture=picture, valid=valid == 255)
    return replace(match, photo=photo, pixels=pixels), straight, radial


def _refined(
    match: _Matched, pose: SolvedPose, covariance: F64, geometry: Geometry
) -> tuple[PosedCamera, Comparison, bool]:
    """Refines a pose if photometric refinement is more certain; the flag: it improved."""
    picture, valid, first = match.photo.picture, match.photo.valid, pose.posed
    longer = max(first.camera.width, first.camera.height)
    deviation_px = shown_deviation(first, match.points[pose.inliers], covariance) * COMPARED_SIDE / longer
    if deviation_px > COMPARISON_DEVIATION_PX:
        posed, comparison, refined = refine_photometrically(picture, first, geometry, valid)
        off = np.linalg.norm(posed.pixels(match.points) - match.pixels, axis=1)
        # The most similar view may contradict the matches in a blurred or changed place.
        if (off < error_px(posed.camera)).sum() >= _KEPT_INLIERS * len(pose.inliers):
            return posed, comparison, refined
    return first, compared(picture, first, geometry, valid=valid), False
