"""The drawn wall as three cameras and two photos of a recording show it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.capture.upload_files import encoded
from tests.query.wall import wall_index

START = 1_700_000_000_250_000_000  # nanoseconds since 1970 at which the recording begins


def seen_wall(rotation: Callable[[float], NDArray[np.float64]]) -> SceneIndex:
    """The wall, seen by three cameras that differ in pose and lens."""
    cameras = []
    for number, angle in enumerate((-0.1, 0.0, 0.15)):
        pose = np.eye(4)
        pose[:3, :3] = rotation(angle)
        pose[:3, 3] = 2 * angle, -angle, 0.1
        cameras.append(PosedCamera(Camera(64, 48 + number, 60.0 + number, 61.0, 31.0, 25.0), pose, f"{number}.png"))
    return wall_index(cameras=cameras)


def _photo(color: tuple[int, int, int]) -> bytes:
    return encoded(Image.new("RGB", (32, 24), color), "JPEG")


PHOTOS = {0: _photo((200, 10, 10)), 2: _photo((10, 10, 200))}  # JPEG files by the number of their camera
