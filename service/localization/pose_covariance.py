"""Estimates the uncertainty of a pose from its matches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fastsplat_contract.geometry.camera import PosedCamera

F64 = NDArray[np.float64]

_MAD = 1.4826  # median of absolute values to standard deviation, normal distribution
_LEAST_PX = 0.3
"""Least keypoint deviation: SIFT is accurate to about a third of a pixel."""
_LEAST_TOLD = 1e-9
_SHARED = 17.0
"""Variance factor for shared errors, covering 95 % of validation photos (docs/measuring.md)."""


def pose_covariance(posed: PosedCamera, pixels: F64, points: F64, *, focal_estimated: bool) -> F64:
    """Estimates the covariance of a pose, float64 [6, 6].

    Ordered as in geometry_msgs/PoseWithCovariance: x, y, z of the camera's center (scene units) and small rotations
    about the world's axes x, y, z (radians). σ² (JᵀJ)⁻¹ over the matches, with the focal length if estimated; σ by
    the median residual (Hartley and Zisserman, 5.2.3), times √17 for shared errors.

    Args:
        pixels: [N, 2], inliers in the photo, N ≥ 4, in front of the camera.
        points: [N, 3], inliers in the world.
        focal_estimated: the focal length comes from these matches.
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
    # A direction that the matches do not constrain gets a large variance.
    inverse = (vectors / np.maximum(values, _LEAST_TOLD)) @ vectors.T / np.outer(lengths, lengths)
    return np.asarray(_SHARED * deviation**2 * inverse[:6, :6])


def shown_deviation(posed: PosedCamera, points: F64, covariance: F64) -> float:
    """RMS deviation in pixels of projected points [N, 3] under a pose covariance; focal exact."""
    jacobian, _ = _pose_jacobian(posed, points)
    return float(np.sqrt(np.einsum("nki,ij,nkj->nk", jacobian, covariance, jacobian).mean()))


def _pose_jacobian(posed: PosedCamera, points: F64) -> tuple[F64, F64]:
    """Jacobian of pixels, [N, 2, 6], and points in the camera's frame, [N, 3].

    Columns as in `pose_covariance`; all points lie in front of the camera.
    """
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
    """Cross-product matrices [v]ₓ of vectors, [N, 3, 3]."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)
