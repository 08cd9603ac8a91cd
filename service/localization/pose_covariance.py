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
_LEAST_TOLD = 1e-9
_SHARED = 17.0
"""Times this is a variance larger than of independent errors, as places of one photo are off together; chosen so that
it holds for 95 % of validation photos, see docs/measuring.md."""


def pose_covariance(posed: PosedCamera, pixels: F64, points: F64, *, focal_estimated: bool) -> F64:
    """float64 [6, 6]: the covariance of position and rotation, as geometry_msgs/PoseWithCovariance orders them: x, y, z
    of the camera's center (scene units) and small rotations about the world's axes x, y, z (radians).

    σ² (JᵀJ)⁻¹ over the matches, with the focal length where that was estimated; σ by the median residual (Hartley and
    Zisserman, 5.2.3), times √17 for errors that matches share.

    Args:
        pixels: float64 [N, 2], where the photo shows the inliers, N ≥ 4, before the camera.
        points: float64 [N, 3], where they are in the world.
        focal_estimated: whether the focal length comes from these matches.
    """
    jacobian, local = _pose_jacobian(posed, points)
    camera, (x, y, z) = posed.camera, local.T
    if focal_estimated:
        by_focal = np.stack([x / z, y / z], axis=1)[:, :, None]
        jacobian = np.concatenate([jacobian, by_focal], axis=2)
    shown = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)
    residuals = (pixels - shown).ravel()
    deviation = max(_LEAST_PX, _MAD * float(np.median(np.abs(residuals))))
    rows = jacobian.reshape(-1, jacobian.shape[2])
    lengths = np.maximum(np.linalg.norm(rows, axis=0), 1e-12)
    values, vectors = np.linalg.eigh((rows / lengths).T @ (rows / lengths))
    # A direction that the matches do not tell is hardly known at all, never surely.
    inverse = (vectors / np.maximum(values, _LEAST_TOLD)) @ vectors.T / np.outer(lengths, lengths)
    return np.asarray(_SHARED * deviation**2 * inverse[:6, :6])


def shown_deviation(posed: PosedCamera, points: F64, covariance: F64) -> float:
    """How far, by a pose's covariance, points [N, 3] may be from where it shows them: root mean square of the standard
    deviations over points and both axes, pixels. The focal length is taken as exact."""
    jacobian, _ = _pose_jacobian(posed, points)
    return float(np.sqrt(np.einsum("nki,ij,nkj->nk", jacobian, covariance, jacobian).mean()))


def _pose_jacobian(posed: PosedCamera, points: F64) -> tuple[F64, F64]:
    """How the pixels of points [N, 3] before a camera move with its position and its rotation about the world's axes,
    float64 [N, 2, 6], and the points in its frame, float64 [N, 3]."""
    pose, camera = posed.world_from_camera, posed.camera
    away = points - pose[:3, 3]
    local = away @ pose[:3, :3]
    x, y, z = local.T
    zero = np.zeros_like(z)
    across = np.stack([camera.fx / z, zero, -camera.fx * x / z**2], axis=1)
    down = np.stack([zero, camera.fy / z, -camera.fy * y / z**2], axis=1)
    moved = np.stack([across, down], axis=1)
    turn = pose[:3, :3].T
    # p = Rᵀ (X - t): by t it moves by -Rᵀ, by exp(ω) R about the world's axes by Rᵀ [X - t]ₓ.
    by_rotation = np.einsum("ij,njk->nik", turn, _cross(away))
    return np.concatenate([-moved @ turn, moved @ by_rotation], axis=2), local


def _cross(vectors: F64) -> F64:
    """[N, 3, 3]: the matrices [v]ₓ with [v]ₓ w = v × w."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)
