"""What database rows hold as JSON: cameras."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fastsplat.service.common.camera import Camera, PosedCamera


def camera_to_json(posed: PosedCamera) -> dict[str, Any]:
    """A posed camera as JSON numbers: intrinsics in pixels, `world_from_camera` row by row."""
    camera = posed.camera
    return {
        "name": posed.name,
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "world_from_camera": posed.world_from_camera.tolist(),
    }


def camera_from_json(row: Mapping[str, Any]) -> PosedCamera:
    """Back from `camera_to_json`, exactly."""
    camera = Camera(row["width"], row["height"], row["fx"], row["fy"], row["cx"], row["cy"])
    return PosedCamera(camera, np.array(row["world_from_camera"], dtype=np.float64), row["name"])
