"""Cameras and points as one zip from which other programs train: nerfstudio's transforms.json and COLMAP's model."""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Mapping, Sequence
from io import BytesIO

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.types import F32
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.poses import quaternion_of

_PINHOLE = 1


def colmap_model(cameras: Sequence[PosedCamera], points: F32, colors: NDArray[np.uint8]) -> dict[str, bytes]:
    """COLMAP's binary model by file name: cameras.bin, images.bin, points3D.bin. Names of images may have blanks.
    Points have no tracks, and errors of 0.

    Args:
        cameras: of the scene; one PINHOLE camera for each distinct lens.
        points: float32 [P, 3], world frame.
        colors: uint8 [P, 3].
    """
    lenses = {lens: number for number, lens in enumerate(dict.fromkeys(posed.camera for posed in cameras), 1)}
    lens_rows = [
        struct.pack("<iiQQ4d", number, _PINHOLE, lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy)
        for lens, number in lenses.items()
    ]
    image_rows = []
    for number, posed in enumerate(cameras, 1):
        viewmat = posed.camera_from_world()
        x, y, z, w = quaternion_of(viewmat[:3, :3])
        row = struct.pack("<i7di", number, w, x, y, z, *viewmat[:3, 3].tolist(), lenses[posed.camera])
        image_rows.append(row + posed.name.encode() + b"\0" + struct.pack("<Q", 0))
    rows = np.zeros(
        len(points), [("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track", "<u8")]
    )
    rows["id"], rows["xyz"], rows["rgb"] = np.arange(1, len(points) + 1), points, colors
    return {
        "cameras.bin": struct.pack("<Q", len(lens_rows)) + b"".join(lens_rows),
        "images.bin": struct.pack("<Q", len(image_rows)) + b"".join(image_rows),
        "points3D.bin": struct.pack("<Q", len(rows)) + rows.tobytes(),
    }


def zipped(files: Mapping[str, bytes]) -> bytes:
    """A zip of the files, the same bytes for the same files."""
    file = BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), content, zipfile.ZIP_DEFLATED)
    return file.getvalue()
