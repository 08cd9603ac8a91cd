"""A pose made better by comparing the photo with the scene's own picture from there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fastsplat.service.query.drawing.view_geometry import ViewGeometry
from fastsplat.service.splatting.photometric import correct, fitted_correction
from fastsplat_contract.camera import PosedCamera

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Geometry = Callable[[PosedCamera], ViewGeometry]

COMPARED_SIDE = 320
"""Photo and scene are compared at so many pixels on the longer side."""

COMPARISON_DEVIATION_PX = 1.2
"""Of these pixels: how exact the pose is from which the scene looks likest: 0.7, measured on two validation scenes,
with the margin for what is shared, √(17/6)."""

_STEPS = 6
_SURE = 0.3
"""Confidence of a pixel's depth from which on it counts."""
_WHOLE = 0.999
_LEAST_PIXELS = 400
_RIM = np.ones((5, 5), np.uint8)
_HUBER = 1.345
_MAD = 1.4826
_BLUR_PX = 1.2
_ENOUGH = 1e-3
"""Steps end where the cost falls by less than this share."""


@dataclass(frozen=True)
class Comparison:
    """A photo beside the scene's picture from a pose, in the size of comparison.

    Attributes:
        posed: the camera, of that size.
        photo: float32 [H, W, 3], 0..1.
        shown: float32 [H, W, 3], 0..1, the scene with the photo's exposure and white balance.
        depth: float32 [H, W], camera z, scene units; 0 where nothing is.
        covered: bool [H, W], where both show something.
        sure: bool [H, W], where the depth of that is sure, too.
        cost: mean of Huber's loss of the differences of gray values, over what is covered; infinite for too little.
    """

    posed: PosedCamera
    photo: F32
    shown: F32
    depth: F32
    covered: NDArray[np.bool_]
    sure: NDArray[np.bool_]
    cost: float


def compared(
    photo: NDArray[np.uint8],
    posed: PosedCamera,
    geometry: Geometry,
    scale: float | None = None,
    valid: NDArray[np.bool_] | None = None,
    side: int = COMPARED_SIDE,
) -> Comparison:
    """A photo beside what the scene shows from a pose.

    Args:
        photo: uint8 [H, W, 3].
        geometry: what a camera sees of the scene.
        scale: of gray values that are likely, for Huber's loss; None: by their median.
        valid: bool [H, W], where the photo shows something; None: everywhere.
        side: pixels on the longer side, at most.
    """
    small = small_camera(posed, side)
    size = small.camera.width, small.camera.height
    target = np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA), np.float32) / np.float32(255)
    seen = geometry(small)
    shown, there, sure = np.asarray(seen.image, np.float32), seen.confidence > 0, seen.confidence > _SURE
    if valid is not None:
        whole = cv2.resize(valid.astype(np.float32), size, interpolation=cv2.INTER_AREA) > _WHOLE
        there, sure = there & whole, sure & whole
    image, light = torch.from_numpy(shown), torch.from_numpy(target)
    fit = fitted_correction(image, light, torch.from_numpy(there.astype(np.float32)), None)
    if fit is not None:
        shown = np.asarray(correct(image, fit).numpy(), np.float32)
    covered, sure = (cv2.erode(part.astype(np.uint8), _RIM) > 0 for part in (there, sure))
    cost = float("inf")
    if covered.sum() >= _LEAST_PIXELS:
        cost = _cost((_gray(target) - _gray(shown))[covered], scale)
    return Comparison(small, target, shown, seen.median_depth, covered, sure, cost)


def refine_photometrically(
    photo: NDArray[np.uint8], posed: PosedCamera, geometry: Geometry, valid: NDArray[np.bool_] | None = None
) -> tuple[PosedCamera, Comparison, bool]:
    """The pose near to a first one from which the scene looks likest to the photo: Gauss-Newton steps on the
    differences of gray values, each kept only if it makes them smaller (as in ESM: Benhimane and Malis, IROS 2004).

    Args:
        photo: uint8 [H, W, 3].
        geometry: what a camera sees of the scene.
        valid: bool [H, W], where the photo shows something; None: everywhere.

    Returns:
        The pose, how the photo compares from there, and whether it is another one than at first.
    """
    first = compared(photo, posed, geometry, valid=valid)
    if not np.isfinite(first.cost):
        return posed, first, False
    scale = _scale((_gray(first.photo) - _gray(first.shown))[first.covered])
    best = first = replace(first, cost=_cost((_gray(first.photo) - _gray(first.shown))[first.covered], scale))
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


def small_camera(posed: PosedCamera, side: int = COMPARED_SIDE) -> PosedCamera:
    """The same view in a picture of at most so many pixels a side."""
    width, height = posed.camera.width, posed.camera.height
    share = min(1.0, side / max(width, height))
    size = max(1, round(width * share)), max(1, round(height * share))
    return replace(posed, camera=posed.camera.scaled_to(*size))


def _step(now: Comparison, scale: float) -> F64 | None:
    """float64 [6]: the motion of the camera in its own frame, position and rotation, that the pictures ask for."""
    photo, shown = _gray(now.photo), _gray(now.shown)
    rows, columns = np.nonzero(now.sure & (now.depth > 0))
    if len(rows) < _LEAST_PIXELS:
        return None
    across, down = (_slope(photo, axis) + _slope(shown, axis) for axis in (0, 1))
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
    residuals = (photo - shown)[rows, columns].astype(np.float64)
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
    """float32 [H, W]: change of a gray value a pixel to the right (axis 0) or down (axis 1)."""
    return np.asarray(cv2.Sobel(gray, cv2.CV_32F, 1 - axis, axis, ksize=3, scale=1 / 8), np.float32)


def _scale(residuals: F32) -> float:
    return max(1e-3, _MAD * float(np.median(np.abs(residuals))))


def _cost(residuals: F32, scale: float | None) -> float:
    bound = _HUBER * (_scale(residuals) if scale is None else scale)
    size = np.abs(residuals.astype(np.float64))
    return float(np.where(size <= bound, 0.5 * size**2, bound * (size - 0.5 * bound)).mean())
