"""Reads Record3D recordings (`.r3d`, zip): video frames with ARKit's poses and depth maps.

    metadata       JSON: "w", "h" of the photos, "dw", "dh" of the depth maps, "K" (9 numbers, column by column) or
                   "perFrameIntrinsicCoeffs" ([fx, fy, cx, cy] a frame), "poses" ([qx, qy, qz, qw, tx, ty, tz] a frame)
    rgbd/0.jpg     photo
    rgbd/0.depth   float32 meters, row by row, compressed by LZFSE; NaN where unknown
    rgbd/0.conf    uint8 of ARKit's levels 0 to 2, compressed likewise; not of the front camera

Layout: https://record3d.app/features and nerfstudio's `process_data/record3d_utils.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.bounded_json import read_json
from fastsplat.service.capture.uploads.left_out import LeftOut
from fastsplat.service.capture.uploads.phones import arkit
from fastsplat.service.capture.uploads.posed_input import MissingImage, PosedDataset, PosedImage, missing_warning
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.poses import Quaternion, Vector3, rigid

_METADATA, _FRAMES = "metadata", "rgbd"


def find_record3d(files: Iterable[str]) -> str:
    """Finds the metadata, relative to the upload; "" if this is no Record3D recording."""
    paths = sorted(map(PurePosixPath, files))
    folders = {path.parent.parent for path in paths if path.parent.name == _FRAMES and path.suffix.lower() == ".jpg"}
    return next((path.as_posix() for path in paths if path.name == _METADATA and path.parent in folders), "")


def read_record3d(
    root: Path, name: str, sizes: Mapping[str, tuple[int, int]], settings: CaptureSettings, left_out: LeftOut
) -> PosedDataset:
    """Reads cameras, poses and depth maps; arguments and errors as `read_polycam`."""
    document = read_json(root / name, name, settings)
    poses = document.get("poses") if isinstance(document, dict) else None
    if not isinstance(poses, list) or not poses:
        raise InvalidInputError(f"{name} has no list of poses", field=name, hint="Export the recording again.")
    size = (arkit.pixel_count(document, "w", name), arkit.pixel_count(document, "h", name))
    depth_size = None
    if "dw" in document or "dh" in document:
        depth_size = (arkit.pixel_count(document, "dw", name), arkit.pixel_count(document, "dh", name))
    folder = PurePosixPath(name).parent / _FRAMES
    chosen, warnings = arkit.spread(range(len(poses)), settings)
    images, missing = [], []
    for index in chosen:
        photo = (folder / f"{index}.jpg").as_posix()
        if photo not in sizes:
            missing.append(MissingImage(f"{index}.jpg", photo))
            continue
        field = f"{name}: frame {index}"
        maps = (folder / f"{index}.{suffix}" for suffix in ("depth", "conf"))
        with left_out.costs(photo, field):
            images.append(
                PosedImage(
                    name=f"{index:06d}.jpg",
                    path=photo,
                    camera_model=arkit.pinhole(_intrinsics(document, index, name), size, field),
                    world_from_camera=arkit.world_from_camera(_matrix(poses[index], field), field),
                    depth=None if depth_size is None else arkit.depth_file(root, maps, 1.0, depth_size),
                )
            )
    warnings += missing_warning(name, missing, len(chosen), settings)
    return arkit.recording(images, name, warnings, left_out)


def _matrix(pose: Any, field: str) -> arkit.F64:
    x, y, z, w, *position = arkit.numbers(pose, 7, f"{field}: pose")
    length = float(np.sqrt(x * x + y * y + z * z + w * w))
    if not 0.5 < length < 2.0:
        raise InvalidInputError.of(field, f": the quaternion has the length {length:g}", "Export the recording again.")
    orientation = Quaternion(*(float(value) / length for value in (x, y, z, w)))
    return rigid(orientation, Vector3(*map(float, position)))


def _intrinsics(document: Mapping[str, Any], index: int, name: str) -> list[float]:
    """Reads (fx, fy, cx, cy) of a frame, which change with focus."""
    rows = document.get("perFrameIntrinsicCoeffs")
    if isinstance(rows, list) and index < len(rows):
        return [float(value) for value in arkit.numbers(rows[index], 4, f"{name}: perFrameIntrinsicCoeffs {index}")]
    k = arkit.numbers(document.get("K"), 9, f"{name}: K")
    return [float(k[0]), float(k[4]), float(k[6]), float(k[7])]
