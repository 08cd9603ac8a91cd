"""How sure a pose is, by the matches that it was made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fastsplat_contract.camera import PosedCamera

F64 = NDArray[np.float64]

_MAD = 1.4826
"""From the median of absolute values to a standard deviation, of a normal distribution."""
_LEAST_PX = 0.3
"""No pose is surer than keypoints that are so many pixels off: SIFT finds them to about a third of a pixel."""
_SHARED = 3.0
"""Times this is a variance larger than of independent errors: places of one photo of the scene are off together. Chosen
on validation photos, see docs/localizing.md."""


def pose_covariance(posed: PosedCamera, pixels: F64, points: F64, *, focal_estimated: bool) -> F64:
    """float64 [6, 6]: the covariance of position and rotation, as geometry_msgs/PoseWithCovariance orders them: x, y, z
    of the camera's center (scene units) and small rotations about the world's axes x, y, z (radians).

    σ² (JᵀJ)⁻¹ of the least squares over the matches, J how a pixel moves with the pose, and with the focal length
    where that was estimated as well; σ by the median of what the residuals are (Hartley and Zisserman, Multiple View
    Geometry, 5.2.3), times √3 for errors that matches share.

    Args:
        posed: the camera.
        pixels: float64 [N, 2], where the photo shows the inliers, N ≥ 4.
        points: float64 [N, 3], where they are in the world.
        focal_estimated: whether the focal length comes from these matches.
    """
    pose, camera = posed.world_from_camera, posed.camera
    away = points - pose[:3, 3]
    local = away @ pose[:3, :3]
    x, y, z = local.T
    ahead = z > 1e-9
    x, y, z, away = x[ahead], y[ahead], z[ahead], away[ahead]
    zero = np.zeros_like(z)
    moved = np.stack(
        [
            np.stack([camera.fx / z, zero, -camera.fx * x / z**2], axis=1),
            np.stack([zero, camera.fy / z, -camera.fy * y / z**2], axis=1),
        ],
        axis=1,
    )  # [N, 2, 3]: a pixel by the point in the camera's frame
    turn = pose[:3, :3].T
    # p = Rᵀ (X - t): by t it moves by -Rᵀ, by R exp(ω) about the world's axes by Rᵀ [X - t]ₓ.
    by_rotation = np.einsum("ij,njk->nik", turn, _cross(away))
    jacobian = np.concatenate([-moved @ turn, moved @ by_rotation], axis=2)
    if focal_estimated:
        by_focal = np.stack([x / z, y / z], axis=1)[:, :, None]
        jacobian = np.concatenate([jacobian, by_focal], axis=2)
    shown = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)
    residuals = (pixels[ahead] - shown).ravel()
    deviation = max(_LEAST_PX, _MAD * float(np.median(np.abs(residuals))))
    rows = jacobian.reshape(-1, jacobian.shape[2])
    return np.asarray(_SHARED * deviation**2 * np.linalg.pinv(rows.T @ rows)[:6, :6])


def _cross(vectors: F64) -> F64:
    """[N, 3, 3]: the matrices [v]ₓ with [v]ₓ w = v × w."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)
