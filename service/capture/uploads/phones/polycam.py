"""Reads Polycam's raw data: keyframes with ARKit's poses, photos, depth and confidence maps.

    keyframes/corrected_images/1234.jpg    photos; images/ before Polycam has optimized the poses
    keyframes/corrected_cameras/1234.json  {"fx", "fy", "cx", "cy", "width", "height", "t_00" ... "t_23", ...}
    keyframes/depth/1234.png               16 bits, millimeters
    keyframes/confidence/1234.png          8 bits, ARKit's three levels spread over 0..255

Layout and axes: https://docs.nerf.studio/quickstart/custom_dataset.html#polycam-capture and nerfstudio's
`process_data/polycam_utils.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath

import numpy as np

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.uploads.left_out import LeftOut
from fastsplat.service.capture.uploads.phones import arkit
from fastsplat.service.capture.uploads.posed_input import MissingImage, PosedDataset, PosedImage, missing_warning

_FOLDERS = {"corrected_cameras": "corrected_images", "cameras": "images"}
"""Folders of poses and their photos; the first are optimized by Polycam."""
_PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png")
_HEAD_BYTES = 4_096


def find_polycam(root: Path, files: Iterable[str]) -> str:
    """Finds the folder of poses, relative to `root`; "" if this is no Polycam recording."""
    candidates = [PurePosixPath(path) for path in files if path.lower().endswith(".json")]
    for name in _FOLDERS:
        for path in candidates:
            if path.parent.name == name and _names_a_pose(root / path):
                return path.parent.as_posix()
    return ""


def read_polycam(
    root: Path, folder: str, sizes: Mapping[str, tuple[int, int]], settings: CaptureSettings, left_out: LeftOut
) -> PosedDataset:
    """Reads cameras, poses and depth maps of a recording.

    Args:
        folder: from `find_polycam`.
        sizes: (width, height) of the upload's images as stored, by path.
        left_out: receives frames with an invalid pose or camera, or an unreadable document.

    Raises:
        InvalidInputError: no frame with a photo is left.
    """
    place = PurePosixPath(folder)
    beside = place.parent
    poses = sorted(path.relative_to(root).as_posix() for path in (root / folder).glob("*.json"))
    chosen, warnings = arkit.spread(poses, settings)
    images, missing = [], []
    for path in chosen:
        stem = PurePosixPath(path).stem
        names = [(beside / _FOLDERS[place.name] / f"{stem}{suffix}").as_posix() for suffix in _PHOTO_SUFFIXES]
        photo = next((name for name in names if name in sizes), None)
        if photo is None:
            missing.append(MissingImage(stem, names[0]))
            continue
        with left_out.costs(photo, path):
            images.append(_image(root, path, photo, beside, settings))
    warnings += missing_warning(folder, missing, len(chosen), settings)
    return arkit.recording(images, folder, warnings, left_out)


def _image(root: Path, path: str, photo: str, beside: PurePosixPath, settings: CaptureSettings) -> PosedImage:
    document = arkit.json_object(root, path, settings)
    matrix = np.eye(4)
    matrix[:3] = [[arkit.number(document, f"t_{row}{column}", path) for column in range(4)] for row in range(3)]
    size = (arkit.pixel_count(document, "width", path), arkit.pixel_count(document, "height", path))
    intrinsics = [arkit.number(document, key, path) for key in ("fx", "fy", "cx", "cy")]
    maps = (beside / name / f"{PurePosixPath(path).stem}.png" for name in ("depth", "confidence"))
    return PosedImage(
        name=PurePosixPath(photo).name,
        path=photo,
        camera_model=arkit.pinhole(intrinsics, size, path),
        world_from_camera=arkit.world_from_camera(matrix, path),
        depth=arkit.depth_file(root, maps),
    )


def _names_a_pose(path: Path) -> bool:
    """Detects a pose by the first bytes alone, as the file may be anything."""
    with path.open("rb") as file:
        return b'"t_' in file.read(_HEAD_BYTES)
