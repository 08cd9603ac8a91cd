"""Projects points into cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fastsplat_contract.geometry.camera import PosedCamera

F64 = NDArray[np.float64]


def reprojected(posed: PosedCamera, points: F64) -> F64:
    """Projects points [M, 3] to pixels, float64 [M, 2]; infinite behind the camera."""
    viewmat = posed.camera_from_world()
    local = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    camera, z = posed.camera, local[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = np.stack([camera.fx * local[:, 0] / z + camera.cx, camera.fy * local[:, 1] / z + camera.cy], axis=1)
    pixels[z <= 0] = np.inf
    return np.asarray(pixels)
