"""Structure from motion by COLMAP. Runs only in the sandbox's child.

Bit-reproducible: ordered images, seeds, no BLAS in matching threads (`_matching_threads`), and a mapper on one thread.
"""

from __future__ import annotations

import ctypes
import os
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat.service.capture.sfm import geometry, pairs, rigs
from fastsplat.service.capture.sfm.early_refusal import refuse_hopeless
from fastsplat.service.capture.sfm.features import extract_features
from fastsplat.service.capture.sfm.mapping import SEED, Mapping, Models, largest_first, map_possible, mapper_options
from fastsplat.service.capture.sfm.mapping_snapshots import keep
from fastsplat.service.capture.sfm.model_agreement import VerifiedMatches
from fastsplat_contract.errors import ReconstructionError

FIRST_IMAGES = 8
"""Mapped at once, if a capture has twice as many; others are mapped soon anyway."""
_APART = 2

Report = Callable[[float, str], None]

_IMAGES_A_STEP = FIRST_IMAGES
_PAIRS_A_STEP = 512
"""Each call indexes its images' features once; calls of 48 took 1.5 times as long."""
_FEATURES_DONE, MATCHING_DONE, _MAPPING_DONE = 0.45, 0.8, 0.98
_MIN_FEATURES = 50
_FAISS_BLAS_THRESHOLD = "_ZN5faiss31distance_compute_blas_thresholdE"
"""faiss::distance_compute_blas_threshold: from so many descriptors on, searches use BLAS."""
_NEVER = 2**31 - 1


def first_pairs() -> list[tuple[int, int]]:
    """Pairs matched before all others: neighbors and next neighbors, which every capture matches."""
    return [(i, i + step) for step in range(1, _APART + 1) for i in range(FIRST_IMAGES - step)]


def place_first(database: Path, images: Path, folder: Path) -> bool:
    """Maps the images matched so far and stores their cameras for `take_placed`.

    Returns:
        False without cameras; the first photos may be from one place or share nothing.
    """
    output = folder / "first"
    output.mkdir()
    models = largest_first(pycolmap.incremental_mapping(database, images, output, options=mapper_options()).values())
    if models:
        keep(models[0], folder)
    return bool(models)


def reconstruct(request: dict[str, Any], folder: Path, report: Report) -> dict[str, Any]:
    """Reconstructs poses, cameras and points of images.

    Args:
        request: "image_folder"; "images": see `SfmImage.to_request`, one camera a group, focal length in pixels or 0
            if unknown; "ordered": the list is in time order; optionally "mask_folder" with `<file>.png`, features only
            where it is above 0; and all settings.
        folder: for the database, "points.npz" (points, colors) and snapshots (`mapping_snapshots`).

    Returns:
        "poses": {file: world_from_camera rows}, "cameras": {file: [model, width, height, params]}, "matches": {file:
        `PhotoMatches` as a list}, "impossible": {file: see `take_out_impossible`}, "models", "error_px" and "warnings".

    Raises:
        ReconstructionError: no usable geometry; see `validate_reconstruction`.
    """
    pycolmap.set_random_seed(SEED)
    database = folder / "features.db"
    images = Path(request["image_folder"])
    files = [image["file"] for image in request["images"]]
    single = not rigs.has_rigs(request["images"])
    import_images(database, images, request["images"])
    extract_and_match(database, images, files, request, folder, report, alone=single)
    if single:
        refuse_hopeless(database, min_share=request["min_registered_share"], complete=True)
    report(MATCHING_DONE, "registering images")
    mapping = Mapping(
        database,
        images,
        folder,
        request["images"],
        lambda copy, image_pairs: _match_guided(copy, image_pairs, request, folder),
        lambda done, message: report(MATCHING_DONE + (_MAPPING_DONE - MATCHING_DONE) * done, message),
    )
    mapped, impossible = map_possible(mapping, request["global_mapping_images"], request["max_side"])
    models, contradictions = mapped.models, mapped.contradictions
    if not models and not impossible:
        raise ReconstructionError("no two images see the same object from different places", hint=geometry.PHOTO_HINT)
    if not models:
        raise ReconstructionError(
            f"the lens of the photos could not be worked out: none of {len(impossible)} has a possible one",
            hint="Send photos as the camera stored them, neither cropped nor edited, taken from different places.",
        )
    best = models[0]
    reconstruction = _summary(best, len(files), tuple(model.num_reg_images() for model in models))
    warnings = geometry.validate_reconstruction(
        reconstruction, min_points=request["min_points"], min_registered_share=request["min_registered_share"]
    )
    warnings += geometry.repetition_warning(*contradictions)
    report(1.0, f"{best.num_reg_images()} of {len(files)} images registered")
    save_points(best, folder)
    image_by_name = {image.name: image for image in best.images.values() if image.has_pose}
    return {
        "poses": {name: world_from_camera(image).tolist() for name, image in image_by_name.items()},
        "cameras": {name: _camera(image.camera) for name, image in image_by_name.items()},
        "matches": _matches_of_images(models, database),
        "impossible": impossible,
        "models": list(reconstruction.models),
        "error_px": best.compute_mean_reprojection_error(),
        "warnings": warnings,
    }


def triangulate(request: dict[str, Any], folder: Path, report: Report) -> dict[str, Any]:
    """Triangulates points of undistorted images with known poses.

    Args:
        request: as in `reconstruct`, each image with "camera": [width, height, fx, fy, cx, cy] and "camera_from_world":
            [4, 4] rows.

    Returns:
        "points": their number, "error_px".

    Raises:
        ReconstructionError: the images contradict the poses, or too few points agree with them.
    """
    pycolmap.set_random_seed(SEED)
    database = folder / "features.db"
    images = Path(request["image_folder"])
    posed_images = request["images"]
    files = [image["file"] for image in posed_images]
    ungrouped = [{**image, "group": index, "focal": 0} for index, image in enumerate(posed_images)]
    import_images(database, images, ungrouped)
    posed = known_poses(database, posed_images)
    extract_and_match(database, images, files, request, folder, report)
    geometry.refuse_wrong_poses(*VerifiedMatches(database).contradictions(posed))
    report(MATCHING_DONE, "triangulating points")
    output = folder / "model"
    output.mkdir()
    result = pycolmap.triangulate_points(posed, database, images, output, options=mapper_options())
    if result.num_points3D() < request["min_points"]:
        raise ReconstructionError(
            f"only {result.num_points3D()} points agree with the camera poses",
            limit=f"{request['min_points']} points",
            hint="Check the convention of the poses (axes, world-from-camera) and the intrinsics, or send points.",
        )
    save_points(result, folder)
    report(1.0, f"{result.num_points3D()} points triangulated")
    return {"points": result.num_points3D(), "error_px": result.compute_mean_reprojection_error()}


def import_images(database: Path, images: Path, entries: list[dict[str, Any]]) -> None:
    """Writes images and cameras to the database, a camera a group, ids in entry order."""
    pycolmap.Database.open(database).close()
    groups = defaultdict(list)
    for image in entries:
        groups[image["group"]].append(image)
    for group in groups.values():
        options = rigs.reader_options(group[0])
        names = [image["file"] for image in group]
        pycolmap.import_images(database, images, pycolmap.CameraMode.SINGLE, image_names=names, options=options)
    rigs.apply_rig(database, entries)


def extract_and_match(
    database: Path,
    images: Path,
    files: list[str],
    request: dict[str, Any],
    folder: Path,
    report: Report,
    *,
    alone: bool = False,
) -> None:
    """Writes features and verified matches to the database.

    Args:
        alone: there are no poses or rigs. Then the first few images are mapped early for display, and the most
            informative pairs are matched first, so that photos from one place are refused before long matching.

    Raises:
        ReconstructionError: the images have hardly any texture, or were all taken from one place.
    """
    masks = Path(request["mask_folder"]) if "mask_folder" in request else None
    for start in range(0, len(files), _IMAGES_A_STEP):
        report(_FEATURES_DONE * start / len(files), f"extracting features {start}/{len(files)}")
        step = files[start : start + _IMAGES_A_STEP]
        extract_features(database, images, step, masks, request, _threads(request))
        if alone and start == 0 and len(files) >= 2 * FIRST_IMAGES:
            _match(database, [(files[i], files[j]) for i, j in first_pairs()], request, folder)
            if place_first(database, images, folder):
                report(_FEATURES_DONE * len(step) / len(files), "the first images have cameras")
    report(_FEATURES_DONE, "choosing image pairs")
    telling = pairs.telling_pairs(len(files)) if alone else []
    image_pairs = [*telling, *sorted({*_choose_pairs(database, files, request)} - {*telling})]
    for start in range(0, len(image_pairs), _PAIRS_A_STEP):
        fraction = _FEATURES_DONE + (MATCHING_DONE - _FEATURES_DONE) * start / len(image_pairs)
        report(fraction, f"matching image pairs {start}/{len(image_pairs)}")
        end = start + _PAIRS_A_STEP
        _match(database, [(files[i], files[j]) for i, j in image_pairs[start:end]], request, folder)
        if start < len(telling) <= end < len(image_pairs):
            refuse_hopeless(database, min_share=request["min_registered_share"], complete=False)


def _match(
    database: Path, names: list[tuple[str, str]], request: dict[str, Any], folder: Path, *, guided: bool = False
) -> None:
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = _matching_threads(_threads(request))
    matching.guided_matching = guided
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = folder / "pairs.txt"
    (folder / "pairs.txt").write_text("".join(f"{first} {second}\n" for first, second in names))
    pycolmap.match_image_pairs(database, matching, pairing, verification, device=pycolmap.Device.cpu)


def _match_guided(
    database: Path, image_pairs: Sequence[tuple[int, int]], request: dict[str, Any], folder: Path
) -> None:
    """Matches pairs of image ids again, with more matches along the epipolar lines."""
    with pycolmap.Database.open(database) as editor:
        names = {image.image_id: image.name for image in editor.read_all_images()}
        for first, second in image_pairs:
            editor.delete_two_view_geometry(first, second)
    _match(database, [(names[first], names[second]) for first, second in image_pairs], request, folder, guided=True)


def _threads(request: dict[str, Any]) -> int:
    return request["sfm_threads"] or os.cpu_count() or 1


def _matching_threads(threads: int) -> int:
    """Chooses the matching threads: all if faiss computes distances without BLAS, else one.

    pycolmap's OpenBLAS has no locks (https://github.com/OpenMathLib/OpenBLAS/pull/2136): pairs may lose matches.
    """
    try:
        threshold = ctypes.c_int.in_dll(ctypes.CDLL(pycolmap._core.__file__), _FAISS_BLAS_THRESHOLD)
    except ValueError:  # a build that hides the symbol
        return 1
    threshold.value = _NEVER
    return threads


def _choose_pairs(database: Path, files: list[str], request: dict[str, Any]) -> list[tuple[int, int]]:
    with pycolmap.Database.open(database) as reader:
        ids = {image.name: image.image_id for image in reader.read_all_images()}
        counts = [reader.num_keypoints_for_image(ids[file]) for file in files]
        if max(counts) < _MIN_FEATURES:
            raise ReconstructionError(
                f"the images have hardly any texture: at most {max(counts)} features in one",
                limit=f"{_MIN_FEATURES} features",
                hint="Send sharp photos of objects with texture; blank walls alone cannot be reconstructed.",
            )
        if len(files) <= request["exhaustive_images"]:
            scores = np.zeros((len(files), len(files)), np.int32)
        else:
            scores = pairs.probe_scores([_probes(reader, ids[file]) for file in files])
    chosen = pairs.choose_pairs(
        scores,
        exhaustive_images=request["exhaustive_images"],
        pairs_per_image=request["pairs_per_image"],
        ordered=request["ordered"],
    )
    return rigs.rig_pairs(chosen, request["images"], request["ordered"])


def _probes(reader: pycolmap.Database, image_id: int) -> NDArray[np.float32]:
    if reader.num_keypoints_for_image(image_id) == 0:
        return np.zeros((0, 128), np.float32)
    return pairs.probes(np.asarray(reader.read_descriptors(image_id).data))


def _summary(model: pycolmap.Reconstruction, images: int, models: tuple[int, ...]) -> geometry.Reconstruction:
    posed = [image for image in model.images.values() if image.has_pose]
    centers = {image.image_id: np.asarray(image.projection_center()) for image in posed}
    angles = [
        geometry.widest_angle_deg(np.stack([centers[element.image_id] for element in point.track.elements]), point.xyz)
        for point in model.points3D.values()
    ]
    return geometry.Reconstruction(
        world_from_camera=np.stack([world_from_camera(image) for image in posed]),
        points=np.array([point.xyz for point in model.points3D.values()]).reshape(-1, 3),
        angles_deg=np.array(angles),
        images=images,
        models=models,
    )


def _matches_of_images(models: Models, database: Path) -> dict[str, list[int | bool | str]]:
    """Collects `PhotoMatches` by file, as lists."""
    placed, elsewhere = (
        {image.image_id for model in some for image in model.images.values() if image.has_pose}
        for some in (models[:1], models[1:])
    )
    best: dict[int, int] = defaultdict(int)
    nearest: dict[int, tuple[int, int, int]] = defaultdict(lambda: (0, 0, 0))
    with pycolmap.Database.open(database) as reader:
        counts = dict(zip(*reader.read_two_view_geometry_num_inliers(), strict=True))
        for pair_id, unverified in zip(*reader.read_num_matches(), strict=True):
            count = int(counts.get(pair_id, 0))
            first, second = pycolmap.pair_id_to_image_pair(pair_id)
            for image_id, other_id in ((first, second), (second, first)):
                best[image_id] = max(best[image_id], count)
                if other_id in placed and other_id != image_id:
                    nearest[image_id] = max(nearest[image_id], (count, int(unverified), -other_id))
        images = reader.read_all_images()
        names = {image.image_id: image.name for image in images}
        return {
            image.name: [
                int(reader.num_keypoints_for_image(image.image_id)),
                best[image.image_id],
                image.image_id in elsewhere and image.image_id not in placed,
                names.get(-nearest[image.image_id][2], ""),
            ]
            for image in images
        }


def known_poses(database: Path, posed_images: list[dict[str, Any]]) -> pycolmap.Reconstruction:
    """Makes a model of known poses with the database's ids; their cameras replace the database's."""
    posed = pycolmap.Reconstruction()
    with pycolmap.Database.open(database) as editor:
        stored = {image.name: image for image in editor.read_all_images()}
        for image in posed_images:
            row = stored[image["file"]]
            width, height, *params = image["camera"]
            camera = pycolmap.Camera(
                camera_id=row.camera_id, model="PINHOLE", width=width, height=height, params=np.array(params)
            )
            camera.has_prior_focal_length = True
            editor.update_camera(camera)
            posed.add_camera_with_trivial_rig(camera)
            pose = pycolmap.Rigid3d(np.array(image["camera_from_world"])[:3])
            posed.add_image_with_trivial_frame(
                pycolmap.Image(name=image["file"], camera_id=row.camera_id, image_id=row.image_id), pose
            )
    return posed


def world_from_camera(image: pycolmap.Image) -> NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3] = image.cam_from_world().inverse().matrix()
    return pose


def _camera(camera: pycolmap.Camera) -> list[Any]:
    return [camera.model.name, camera.width, camera.height, [float(value) for value in camera.params]]


def save_points(model: pycolmap.Reconstruction, folder: Path) -> None:
    points = np.array([point.xyz for point in model.points3D.values()], dtype=np.float64).reshape(-1, 3)
    colors = np.array([point.color for point in model.points3D.values()], dtype=np.uint8).reshape(-1, 3)
    # A feature with two orientations gives the same point twice.
    _, first = np.unique(points.astype(np.float32), axis=0, return_index=True)
    rows = np.sort(first)
    np.savez(folder / "points.npz", points=points[rows], colors=colors[rows])
