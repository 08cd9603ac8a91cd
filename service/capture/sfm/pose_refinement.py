"""Refines tracked phone poses by photos. Runs only in the sandbox's child.

In rounds, points are triangulated and both are bundle-adjusted with position priors from the tracker. Finally, all
cameras are aligned rigidly to the tracked ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat.service.capture.sfm import geometry
from fastsplat.service.capture.sfm import reconstruction as sfm
from fastsplat.service.capture.sfm.mapping import SEED, mapper_options
from fastsplat.service.capture.sfm.model_agreement import VerifiedMatches
from fastsplat.service.common.similarity import fit_similarity

Report = Callable[[float, str], None]
F64 = NDArray[np.float64]

_POSITION_M = 0.05
"""Of tracking, 1 σ: ARKit drifts 2 cm/s (Kim et al. 2022, Sensors 22, 9873)."""
_ROTATION = float(np.deg2rad(1.0))  # tracked rotations, 1 σ
_ROUNDS_PX = (12.0, 6.0, 4.0)
"""Reprojection limit in each round; a degree is 8 to 25 pixels of a photo."""
_MOST_SHIFT_M, _MOST_SHIFT_SHARE = 0.15, 0.1
_MOST_TURN_DEG = 6.0
"""Limits of the median motion, in meters, shares of the cameras' extent, and degrees."""
_LEAST_FEATURES = 30  # cameras with fewer points keep their tracked pose


def refine(request: dict[str, Any], folder: Path, report: Report) -> dict[str, Any]:
    """Refines tracked poses of undistorted images and triangulates points.

    Takes what `sfm.triangulate` takes, in a metric world.

    Returns:
        "poses": {file: world_from_camera rows} of the refined cameras, empty if refused; "refused": the reason, or "";
        "shift_m", "turn_deg": medians over the refined; "points", "error_px".

    Raises:
        ReconstructionError: the images have hardly any texture, or contradict the poses before and after.
    """
    pycolmap.set_random_seed(SEED)
    database, images = folder / "features.db", Path(request["image_folder"])
    posed_images = request["images"]
    files = [image["file"] for image in posed_images]
    ungrouped = [{**image, "group": index, "focal": 0} for index, image in enumerate(posed_images)]
    sfm.import_images(database, images, ungrouped)
    tracked = sfm.known_poses(database, posed_images)
    sfm.extract_and_match(database, images, files, request, folder, report)
    report(sfm.MATCHING_DONE, "refining poses")
    before = {image.name: sfm.world_from_camera(image) for image in tracked.images.values()}
    verified, model = VerifiedMatches(database), tracked
    contradictions = verified.contradictions(tracked)
    for index, error_px in enumerate(_ROUNDS_PX):
        model = _triangulated(model, database, images, folder / f"round{index}", error_px)
        _adjust(model, before)
    _align(model, before)
    after = {
        image.name: sfm.world_from_camera(image)
        for image in model.images.values()
        if image.num_points3D >= _LEAST_FEATURES
    }
    shift, turn = _moves(before, after)
    left = verified.contradictions(model)
    geometry.refuse_wrong_poses(*min(contradictions, left))
    refused = refusal(np.array([pose[:3, 3] for pose in before.values()]), shift, turn, contradictions, left)
    if refused:
        after = {}
    refined = {file: {"camera_from_world": np.linalg.inv(pose).tolist()} for file, pose in after.items()}
    final = sfm.known_poses(database, [{**image, **refined.get(image["file"], {})} for image in posed_images])
    final = _triangulated(final, database, images, folder / "final", _ROUNDS_PX[-1])
    sfm.save_points(final, folder)
    report(1.0, f"{len(after)} of {len(files)} poses refined")
    return {
        "poses": {name: pose.tolist() for name, pose in after.items()},
        "refused": refused,
        "shift_m": float(np.median(shift)) if len(shift) else 0.0,
        "turn_deg": float(np.median(turn)) if len(turn) else 0.0,
        "points": final.num_points3D(),
        "error_px": final.compute_mean_reprojection_error() if final.num_points3D() else 0.0,
    }


def _triangulated(
    model: pycolmap.Reconstruction, database: Path, images: Path, output: Path, error_px: float
) -> pycolmap.Reconstruction:
    output.mkdir()
    options = mapper_options()
    options.mapper.filter_max_reproj_error = error_px
    options.triangulation.complete_max_reproj_error = error_px
    options.triangulation.merge_max_reproj_error = error_px
    return pycolmap.triangulate_points(model, database, images, output, options=options)


def _adjust(model: pycolmap.Reconstruction, before: Mapping[str, F64]) -> None:
    """Adjusts poses and points; phones know their intrinsics, so these stay."""
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_principal_point = options.refine_extra_params = False
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    options.ceres.solver_options.num_threads = 1
    config = pycolmap.BundleAdjustmentConfig()
    priors = []
    for image_id, image in sorted(model.images.items()):
        config.add_image(image_id)
        prior = pycolmap.PosePrior()
        prior.pose_prior_id = image_id
        prior.corr_data_id = image.data_id
        prior.position = before[image.name][:3, 3]
        prior.position_covariance = np.eye(3) * _POSITION_M**2
        prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
        priors.append(prior)
    for camera_id in model.cameras:
        config.set_constant_cam_intrinsics(camera_id)
    prior_options = pycolmap.PosePriorBundleAdjustmentOptions()
    prior_options.alignment_ransac.random_seed = SEED
    pycolmap.create_pose_prior_bundle_adjuster(options, prior_options, config, priors, model).solve()


def _align(model: pycolmap.Reconstruction, before: Mapping[str, F64]) -> None:
    """Aligns a model rigidly to the tracked cameras, by their centers and axis ends."""
    length = _POSITION_M / _ROTATION
    ends = np.concatenate([np.zeros((3, 1)), length * np.eye(3)], axis=1)
    images = [image for image in model.images.values() if image.num_points3D >= _LEAST_FEATURES]
    if not images:
        return

    def corners(pose: F64) -> F64:
        return np.asarray((pose[:3, :3] @ ends + pose[:3, 3:]).T)

    ours = np.concatenate([corners(sfm.world_from_camera(image)) for image in images])
    theirs = np.concatenate([corners(before[image.name]) for image in images])
    back = fit_similarity(ours, theirs, scaled=False)
    model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(back.rotation), back.translation))


def _moves(before: Mapping[str, F64], after: Mapping[str, F64]) -> tuple[F64, F64]:
    """Motion of each refined camera: meters, and degrees."""
    relative = np.array([np.linalg.inv(before[name]) @ pose for name, pose in sorted(after.items())]).reshape(-1, 4, 4)
    cosine = (np.trace(relative[:, :3, :3], axis1=1, axis2=2) - 1) / 2
    return np.linalg.norm(relative[:, :3, 3], axis=1), np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))


def refusal(positions: F64, shift: F64, turn: F64, contradictions: tuple[int, int], left: tuple[int, int]) -> str:
    """Gives the reason to refuse refined poses, or "".

    Args:
        positions: [N, 3] of all cameras as tracked, meters.
        shift, turn: [R] of the refined ones, meters and degrees.
        contradictions, left: `geometry.contradictions` of the tracked and of the refined poses.
    """
    if not len(shift):
        return "too few features agree between the photos"
    extent = float(np.linalg.norm(positions - positions.mean(0), axis=1).max())
    most = max(_MOST_SHIFT_M, _MOST_SHIFT_SHARE * extent)
    if not np.median(shift) <= most or not np.median(turn) <= _MOST_TURN_DEG:
        return f"they would move by {np.median(shift):.2f} m and turn by {np.median(turn):.1f} degrees"
    if left[0] > contradictions[0]:
        return f"{left[0]} pairs of photos would contradict them, {contradictions[0]} contradict the tracked ones"
    return ""
