"""Refines a pose by comparing the photo with the scene's rendering from there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fastsplat.service.query.drawing.view_geometry import ViewGeometry
from fastsplat.service.splatting.exposure.photometric import correct, fitted_correction
from fastsplat_contract.geometry.camera import PosedCamera

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Geometry = Callable[[PosedCamera], ViewGeometry]

COMPARED_SIDE = 320  # pixels on the longer side

COMPARISON_DEVIATION_PX = 1.2
"""0.7, measured on two validation scenes, times the margin √(17/6) for shared errors."""

_STEPS = 6
_SURE = 0.3  # depth confidence from which on a pixel counts
_WHOLE = 0.999
_LEAST_PIXELS = 400
_RIM = np.ones((5, 5), np.uint8)
_HUBER = 1.345
_MAD = 1.4826
_BLUR_PX = 1.2
_ENOUGH = 1e-3  # relative fall of the cost at which the iteration ends


@dataclass(frozen=True)
class Comparison:
    """A photo beside the scene's rendering from a pose, at reduced size."""

    posed: PosedCamera  # of the reduced size
    photo: F32  # [H, W, 3], 0..1
    rendering: F32  # [H, W, 3], 0..1, the scene with the photo's exposure and white balance
    depth: F32  # [H, W], camera z, scene units; 0 where nothing is
    covered: NDArray[np.bool_]  # [H, W], where both show something
    sure: NDArray[np.bool_]  # [H, W], covered, with a sure depth
    cost: float  # mean Huber loss of gray differences where covered; infinite if too little is


def compared(
    photo: NDArray[np.uint8],  # [H, W, 3]
    posed: PosedCamera,
    geometry: Geometry,
    scale: float | None = None,
    valid: NDArray[np.bool_] | None = None,  # [H, W]
    side: int = COMPARED_SIDE,
) -> Comparison:
    """Compares a photo with the scene's rendering from a pose.

    Args:
        scale: expected gray residual for the Huber loss; None: estimated from their median.
        valid: where the photo has content; None: everywhere.
        side: limit of the longer side, pixels.
    """
    small = posed.limited_to(side)
    size = small.camera.width, small.camera.height
    target = np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA), np.float32) / np.float32(255)
    seen = geometry(small)
    rendering, there, sure = np.asarray(seen.image, np.float32), seen.confidence > 0, seen.confidence > _SURE
    if valid is not None:
        whole = cv2.resize(valid.astype(np.float32), size, interpolation=cv2.INTER_AREA) > _WHOLE
        there, sure = there & whole, sure & whole
    image, light = torch.from_numpy(rendering), torch.from_numpy(target)
    fit = fitted_correction(image, light, torch.from_numpy(there.astype(np.float32)), None)
    if fit is not None:
        rendering = np.asarray(correct(image, fit).numpy(), np.float32)
    covered, sure = (cv2.erode(part.astype(np.uint8), _RIM) > 0 for part in (there, sure))
    cost = float("inf")
    if covered.sum() >= _LEAST_PIXELS:
        cost = _cost((_gray(target) - _gray(rendering))[covered], scale)
    return Comparison(small, target, rendering, seen.median_depth, covered, sure, cost)


def refine_photometrically(
    photo: NDArray[np.uint8], posed: PosedCamera, geometry: Geometry, valid: NDArray[np.bool_] | None = None
) -> tuple[PosedCamera, Comparison, bool]:
    """Refines a pose by Gauss-Newton steps on gray differences.

    Each step is kept only if the cost falls; gradients of both images are averaged as in ESM (Benhimane and Malis, IROS
    2004).

    Args:
        photo: uint8 [H, W, 3].
        valid: bool [H, W], where the photo has content; None: everywhere.

    Returns:
        The pose, its comparison, and whether the pose changed.
    """
    first = compared(photo, posed, geometry, valid=valid)
    if not np.isfinite(first.cost):
        return posed, first, False
    scale = _scale((_gray(first.photo) - _gray(first.rendering))[first.covered])
    best = first = replace(first, cost=_cost((_gray(first.photo) - _gray(first.rendering))[first.covered], scale))
    pose = posed
    for _ in range(_STEPS):
        step = _step(best, scale)
        if step is None:
            break
        for share in (1.0, 0.4):
            moved = _moved(pose, share * step)
            after = compared(photo, moved, geometry, scale, valid)
            if after.cost < best.cost and after.covered.sum() > 0.8 * first.covered.sum():
                break
        else:
            break
        gained = (best.cost - after.cost) / max(best.cost, 1e-12)
        pose, best = moved, after
        if gained < _ENOUGH:
            break
    return pose, best, pose is not posed


def _step(now: Comparison, scale: float) -> F64 | None:
    """Gauss-Newton step in the camera's own frame, float64 [6], position and rotation."""
    photo, rendering = _gray(now.photo), _gray(now.rendering)
    rows, columns = np.nonzero(now.sure & (now.depth > 0))
    if len(rows) < _LEAST_PIXELS:
        return None
    across, down = (_slope(photo, axis) + _slope(rendering, axis) for axis in (0, 1))
    gradient = 0.5 * np.stack([across[rows, columns], down[rows, columns]], axis=1).astype(np.float64)
    camera = now.posed.camera
    depth = now.depth[rows, columns].astype(np.float64)
    x, y = (columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy
    along_x, along_y = gradient[:, 0] * camera.fx, gradient[:, 1] * camera.fy
    along_z = -(along_x * x + along_y * y)
    # A surface's point p moves by -v - ω × p in the camera's frame where the camera moves by (v, ω).
    by_motion = np.stack([along_x, along_y, along_z], axis=1) / depth[:, None]
    points = np.stack([x, y, np.ones_like(x)], axis=1) * depth[:, None]
    jacobian = np.concatenate([by_motion, np.cross(points, by_motion)], axis=1)
    residuals = (photo - rendering)[rows, columns].astype(np.float64)
    weights = np.minimum(1.0, _HUBER * scale / np.maximum(np.abs(residuals), 1e-9))
    weighted = jacobian * weights[:, None]
    normal = weighted.T @ jacobian
    normal += 1e-6 * np.diag(np.diag(normal)) + 1e-12 * np.eye(6)
    step = np.linalg.solve(normal, weighted.T @ residuals)
    return step if np.isfinite(step).all() else None


def _moved(posed: PosedCamera, step: F64) -> PosedCamera:
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(step[3:]).as_matrix()
    motion[:3, 3] = step[:3]
    return replace(posed, world_from_camera=posed.world_from_camera @ motion)


def _gray(picture: F32) -> F32:
    gray = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.GaussianBlur(gray, (0, 0), _BLUR_PX), np.float32)


def _slope(gray: F32, axis: int) -> F32:
    """Gray gradient per pixel to the right (axis 0) or down (axis 1), [H, W]."""
    return np.asarray(cv2.Sobel(gray, cv2.CV_32F, 1 - axis, axis, ksize=3, scale=1 / 8), np.float32)


def _scale(residuals: F32) -> float:
    return max(1e-3, _MAD * float(np.median(np.abs(residuals))))


def _cost(residuals: F32, scale: float | None) -> float:
    bound = _HUBER * (_scale(residuals) if scale is None else scale)
    size = np.abs(residuals.astype(np.float64))
    return float(np.where(size <= bound, 0.5 * size**2, bound * (size - 0.5 * bound)).mean())
