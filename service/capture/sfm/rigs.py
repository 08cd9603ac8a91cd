"""Rigs of panorama faces, which share a center and have known rotations."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

_NEXT_FRAMES = (1, 2)
_LEAST_FISHEYE_FOCAL = 0.2  # over the longer side: 286° of view


def reader_options(image: dict[str, Any]) -> pycolmap.ImageReaderOptions:
    """Makes the camera options of an image's group; see `SfmImage.to_request`."""
    options = pycolmap.ImageReaderOptions()
    options.camera_model = image.get("model", "SIMPLE_RADIAL")
    if image["focal"]:  # the principal point is the middle
        size = image["width"], image["height"]
        camera = pycolmap.Camera.create_from_model_name(1, options.camera_model, image["focal"], *size)
        options.camera_params = ",".join(str(value) for value in camera.params)
    return options


def apply_rig(database: Path, images: Sequence[dict[str, Any]]) -> None:
    """Makes the panorama faces frames of one rig, whose cameras differ in rotation only."""
    by_face = {image["file"].partition("/")[0]: image for image in images if image.get("camera_from_face") is not None}
    if not by_face:
        return
    with pycolmap.Database.open(database) as editor:
        camera_of = {image.name: image.camera_id for image in editor.read_all_images()}
        first = np.array(next(iter(by_face.values()))["camera_from_face"])
        cameras = []
        for index, (face, image) in enumerate(by_face.items()):
            camera = pycolmap.RigConfigCamera()
            camera.ref_sensor, camera.image_prefix = index == 0, f"{face}/"
            if index:
                face_from_first = np.array(image["camera_from_face"]).T @ first
                camera.cam_from_rig = pycolmap.Rigid3d(pycolmap.Rotation3d(face_from_first), np.zeros(3))
            camera.camera = editor.read_camera(camera_of[image["file"]])
            cameras.append(camera)
        config = pycolmap.RigConfig()
        config.cameras = cameras
        pycolmap.apply_rig_config([config], editor)


def has_rigs(images: Sequence[dict[str, Any]]) -> bool:
    """Checks for panorama faces among the images."""
    return any(image.get("camera_from_face") is not None for image in images)


def hold_rigs(options: pycolmap.IncrementalPipelineOptions, database: Path, images: Sequence[dict[str, Any]]) -> None:
    """Fixes the rotations and cameras of faces during registration."""
    faces = {image["file"] for image in images if image.get("camera_from_face") is not None}
    if faces:
        with pycolmap.Database.open(database) as reader:
            fixed = {image.camera_id for image in reader.read_all_images() if image.name in faces}
        options.ba_refine_sensor_from_rig = False
        options.constant_cameras = fixed


def rig_pairs(pairs: list[tuple[int, int]], images: Sequence[dict[str, Any]], ordered: bool) -> list[tuple[int, int]]:
    """Drops pairs within a panorama, useless for its place; in videos, adds next frames'."""
    faces = [image.get("camera_from_face") is not None for image in images]
    frames = [
        image["file"].partition("/")[2] if face else str(index)
        for index, (image, face) in enumerate(zip(images, faces, strict=True))
    ]
    chosen = {(i, j) for i, j in pairs if frames[i] != frames[j]}
    if ordered and any(faces):
        rows = defaultdict(list)
        for index, frame in enumerate(frames):
            rows[frame].append(index)
        order = list(rows.values())
        for step in _NEXT_FRAMES:
            for here, there in zip(order, order[step:], strict=False):
                chosen |= {(min(i, j), max(i, j)) for i in here for j in there}
    return sorted(chosen)


def relative_focal(camera: pycolmap.Camera) -> float:
    """Focal length over the longer side; for fisheyes, of an equally wide pinhole (≤ 120°)."""
    focal = float(camera.mean_focal_length() / max(camera.width, camera.height))
    if not camera.model.name.endswith("FISHEYE") or focal < _LEAST_FISHEYE_FOCAL:
        return focal
    return 0.5 / math.tan(min(0.5 / focal, math.radians(60.0)))
