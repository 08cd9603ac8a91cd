"""Solves the poses of photos whose relative poses are roughly known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat.service.localization.matching import Matches
from fastsplat.service.localization.pose_solving import SolvedPose, colmap_camera, error_px, refine_pose
from fastsplat.service.localization.projection import reprojected
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.photos.localization import FocalSource

F64 = NDArray[np.float64]

_TRIALS = 3_000
_FEWEST = 6
_ROUGH = 4.0  # times the inlier error of an exact pose, as rough poses move pixels


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
    rows = np.concatenate([np.full(len(one), number) for number, one in enumerate(matches)])
    if len(rows) < _FEWEST:
        return (None,) * len(matches)
    options = pycolmap.RANSACOptions()
    options.max_error = _ROUGH * max(error_px(camera) for _, camera in cameras)
    options.max_num_trials, options.min_num_trials = _TRIALS, 100
    options.random_seed = 0
    refinement = pycolmap.AbsolutePoseRefinementOptions()
    refinement.refine_focal_length = refinement.refine_extra_params = refinement.print_summary = False
    answer = pycolmap.estimate_and_refine_generalized_absolute_pose(
        np.concatenate(pixels),
        np.concatenate(points),
        rows.tolist(),
        [pycolmap.Rigid3d(np.linalg.inv(pose)[:3]) for pose in rough],
        [colmap_camera(camera) for _, camera in cameras],
        options,
        refinement,
    )
    if answer is None:
        return (None,) * len(matches)
    world_from_rough = np.eye(4)
    world_from_rough[:3] = answer["rig_from_world"].inverse().matrix()
    solved = []
    for number, (source, camera) in enumerate(cameras):
        posed = PosedCamera(camera, world_from_rough @ rough[number])
        off = np.linalg.norm(reprojected(posed, points[number]) - pixels[number], axis=1)
        near = np.flatnonzero(off < _ROUGH * error_px(camera)).astype(np.int64)
        start = SolvedPose(posed, near, len(np.unique(matches[number].keypoints[near])), source)
        own = (
            refine_pose(pixels[number], points[number], matches[number], start) if start.keypoints >= _FEWEST else None
        )
        solved.append(own or start)
    return tuple(solved)
