"""Writes cameras and points as COLMAP models."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.artefact.scene import F32
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.poses import quaternion_of

_PINHOLE = 1


def colmap_model(cameras: Sequence[PosedCamera], points: F32, colors: NDArray[np.uint8]) -> dict[str, bytes]:
    """Builds COLMAP's binary model: cameras.bin, images.bin, points3D.bin.

    Image names may contain spaces. Points have no tracks and an error of 0. Each distinct lens is one PINHOLE camera.
    """
    lens_rows = [
        struct.pack("<iiQQ4d", number, _PINHOLE, lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy)
        for lens, number in _lenses(cameras).items()
    ]
    image_rows = [
        struct.pack("<i7di", number, *pose, lens) + name.encode() + b"\0" + struct.pack("<Q", 0)
        for number, pose, lens, name in _images(cameras)
    ]
    rows = np.zeros(
        len(points), [("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track", "<u8")]
    )
    rows["id"], rows["xyz"], rows["rgb"] = np.arange(1, len(points) + 1), points, colors
    return {
        "cameras.bin": struct.pack("<Q", len(lens_rows)) + b"".join(lens_rows),
        "images.bin": struct.pack("<Q", len(image_rows)) + b"".join(image_rows),
        "points3D.bin": struct.pack("<Q", len(rows)) + rows.tobytes(),
    }


def colmap_text_model(cameras: Sequence[PosedCamera]) -> dict[str, bytes]:
    """Builds COLMAP's text model: cameras.txt, images.txt and an empty points3D.txt.

    Each distinct lens is one PINHOLE camera. Camera names must not contain spaces.
    """
    lens_lines = [
        f"{number} PINHOLE {lens.width} {lens.height} {lens.fx!r} {lens.fy!r} {lens.cx!r} {lens.cy!r}\n"
        for lens, number in _lenses(cameras).items()
    ]
    image_lines = [
        f"{number} {' '.join(map(repr, pose))} {lens} {name}\n\n" for number, pose, lens, name in _images(cameras)
    ]
    return {
        "cameras.txt": "".join(lens_lines).encode(),
        "images.txt": "".join(image_lines).encode(),
        "points3D.txt": b"",
    }


def _lenses(cameras: Sequence[PosedCamera]) -> dict[Camera, int]:
    return {lens: number for number, lens in enumerate(dict.fromkeys(posed.camera for posed in cameras), 1)}


def _images(cameras: Sequence[PosedCamera]) -> Iterator[tuple[int, tuple[float, ...], int, str]]:
    """Yields each image's number, camera-from-world (w x y z, translation), lens number and name."""
    lenses = _lenses(cameras)
    for number, posed in enumerate(cameras, 1):
        viewmat = posed.camera_from_world()
        x, y, z, w = quaternion_of(viewmat[:3, :3])
        yield number, (w, x, y, z, *viewmat[:3, 3].tolist()), lenses[posed.camera], posed.name
