"""Removes images whose cameras or poses diverged in bundle adjustment. For the sandbox's child.

A photo that shares its camera with no other constrains its lens little.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pycolmap

from fastsplat.service.capture.photos.camera_model import CameraModel, check_camera_model
from fastsplat.service.capture.photos.lens_faces import lens_of
from fastsplat.service.capture.sfm import rigs
from fastsplat.service.capture.sfm.mapping import Mapped, Mapping, largest_first
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.photos.photo_verdicts import NotPlaced

_FOCAL_RANGE = (0.25, 8.0)  # over the longer side: 127° to 7° of view


def map_possible(mapping: Mapping, global_images: int, max_side: int) -> tuple[Mapped, dict[str, NotPlaced]]:
    """Maps images without impossible ones; returns the reasons of those, by file.

    Maps again without them if others are unplaced, which they may have displaced.
    """
    mapped = mapping.run(global_images)
    _ = mapped.contradictions  # cached first: pairs with one unplaced image contradict a model, too
    impossible = take_out_impossible(mapped.models, max_side)
    models = largest_first(model for model in mapped.models if model.num_reg_images())
    left = len(mapping.entries) - len(impossible)
    if not impossible or left < 2 or (models and models[0].num_reg_images() >= left):
        mapped.models[:] = models
        return mapped, impossible
    mapped, more = map_possible(mapping.without(impossible), global_images, max_side)
    return mapped, impossible | more


def take_out_impossible(models: Sequence[pycolmap.Reconstruction], max_side: int) -> dict[str, NotPlaced]:
    """Removes impossible images, their observations, and points without a finite position.

    Returns:
        The reason by image name: "lens" or "unknown".
    """
    reasons: dict[str, NotPlaced] = {}
    for model in models:
        impossible = {number for number, camera in model.cameras.items() if not _is_possible(camera, max_side)}
        for image in [image for image in model.images.values() if image.has_pose]:
            if image.camera_id in impossible:
                reasons[image.name] = "lens"
            elif not np.isfinite(image.cam_from_world().matrix()).all():
                reasons[image.name] = "unknown"
            else:
                continue
            if image.has_pose:  # else removed with another image of its frame
                model.deregister_frame(image.frame_id)
        for number in [number for number, point in model.points3D.items() if not np.isfinite(point.xyz).all()]:
            model.delete_point3D(number)
    placed = {image.name for model in models for image in model.images.values() if image.has_pose}
    return {name: reason for name, reason in reasons.items() if name not in placed}


def _is_possible(camera: pycolmap.Camera, max_side: int) -> bool:
    if not np.isfinite(camera.params).all():
        return False
    if not _FOCAL_RANGE[0] <= rigs.relative_focal(camera) <= _FOCAL_RANGE[1]:
        return False
    params = tuple(float(value) for value in camera.params)
    camera_model = CameraModel(camera.model.name, camera.width, camera.height, params)
    try:
        check_camera_model(camera_model, field="camera")
        lens_of(camera_model, max_side, field="camera")
    except InvalidInputError:
        return False
    return True
