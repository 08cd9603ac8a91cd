"""Initializes Gaussians at the capture's points, or at random points in view."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.scene.artefact.scene import SH_C0
from fastsplat.service.splatting.training_views import TrainingView
from fastsplat_contract.errors import InvalidInputError

_ENOUGH_POINTS = 100
_RANDOM_POINTS = 5_000
_START_OPACITY = 0.1
_SINGLE_TREE = 4  # FLANN_INDEX_KDTREE_SINGLE
_FARTHEST = 1e18  # squares of larger coordinates leave float32

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class StartPoints:
    """Initial positions and colors."""

    points: F32  # [P, 3], world frame
    colors: F32  # [P, 3], 0..1
    random: int  # how many were placed at random, for lack of capture points


def scene_extent(views: tuple[TrainingView, ...], points: F32) -> float:
    """Returns the unit of position steps.

    1.1 times the largest distance of a camera from their center (3DGS), but at least 0.3 times the median distance to
    the points, because a single camera or a tripod has no spread.
    """
    positions = np.stack([view.position.numpy() for view in views]).astype(np.float64)
    center = positions.mean(axis=0)
    spread = 1.1 * float(np.linalg.norm(positions - center, axis=1).max())
    depth = float(np.median(np.linalg.norm(points.astype(np.float64) - center, axis=1))) if len(points) else 0.0
    return max(spread, 0.3 * depth, 1e-6)


def start_points(
    points: F32, colors: NDArray[np.uint8], views: tuple[TrainingView, ...], budget: int, seed: int
) -> StartPoints:
    """Returns at most `budget` initial points.

    Fewer than 100 get 5,000 more, random in the cameras' common field of view, with the color of the pixel they were
    cast from.

    Raises:
        InvalidInputError: a coordinate is NaN, infinite or beyond 1e18.
    """
    sound = (np.abs(points) <= _FARTHEST).all(axis=1)  # False for NaN
    if not sound.all():
        raise InvalidInputError(
            f"{int((~sound).sum())} points have NaN, infinite or immense coordinates",
            field="points",
            limit=f"{_FARTHEST:g} from the origin",
            hint="Remove these points from the point cloud.",
        )
    random = np.random.default_rng((seed, 1))
    shade = colors.astype(np.float32) / 255
    added = 0
    if len(points) < _ENOUGH_POINTS:
        extra, extra_shade = _random_points(views, min(_RANDOM_POINTS, budget), random)
        points, shade, added = np.concatenate([points, extra]), np.concatenate([shade, extra_shade]), len(extra)
    if len(points) > budget:
        sample = np.sort(random.choice(len(points), budget, replace=False))
        added = int((sample >= len(points) - added).sum())
        points, shade = points[sample], shade[sample]
    return StartPoints(np.ascontiguousarray(points, np.float32), np.ascontiguousarray(shade, np.float32), added)


def start_gaussians(start: StartPoints, extent: float, max_sh_degree: int) -> dict[str, Tensor]:
    """Creates faint isotropic Gaussians as wide as the distance to 3 neighbors (3DGS)."""
    count = len(start.points)
    neighbors = min(3, count - 1)
    if neighbors > 0:
        width = np.sqrt(_squared_distances(start.points, neighbors).mean(axis=1))
    else:
        width = np.full(count, 0.1 * extent)
    width = np.clip(width, 1e-5 * extent, 0.3 * extent)
    logit = np.log(_START_OPACITY / (1 - _START_OPACITY))
    return {
        "means": torch.from_numpy(start.points),
        "quats": torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        "log_scales": torch.from_numpy(np.log(width).astype(np.float32))[:, None].repeat(1, 3),
        "logit_opacities": torch.from_numpy(np.full(count, logit, np.float32)),
        "sh_dc": torch.from_numpy(((start.colors - 0.5) / SH_C0).astype(np.float32))[:, None, :],
        "sh_rest": torch.zeros(count, (max_sh_degree + 1) ** 2 - 1, 3),
    }


def _squared_distances(points: F32, neighbors: int) -> NDArray[np.float64]:
    """Exact squared distances to the nearest other points, ascending, [P, neighbors]."""
    # OpenCV is loaded anyway; scipy's tree would add 26 MiB of modules to the trainer.
    tree = cv2.flann.Index(points, {"algorithm": _SINGLE_TREE, "leaf_max_size": 10})
    distances = tree.knnSearch(points, neighbors + 1, params={"checks": -1, "eps": 0.0, "sorted": True})[1]
    return np.asarray(distances)[:, 1:].astype(np.float64)


def project(points: F32, view: TrainingView) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Projects points into the view's largest frame: pixels (row, column) [P, 2], inside [P]."""
    camera = view.frames[-1].camera
    viewmat = view.viewmat.numpy().astype(np.float64)
    local = points.astype(np.float64) @ viewmat[:3, :3].T + viewmat[:3, 3]
    depth = np.where(local[:, 2] > 1e-6, local[:, 2], np.inf)
    column = np.floor(local[:, 0] / depth * camera.fx + camera.cx)
    row = np.floor(local[:, 1] / depth * camera.fy + camera.cy)
    inside = np.isfinite(depth) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    pixels = np.where(inside[:, None], np.stack([row, column], axis=1), 0).astype(np.int64)
    return pixels, inside


def _random_points(views: tuple[TrainingView, ...], count: int, random: np.random.Generator) -> tuple[F32, F32]:
    """Casts rays from random pixels; keeps the [count, 3] points that most cameras see."""
    distance = _viewing_distance(views)
    source = random.integers(len(views), size=4 * count)
    inverse_depth = random.uniform(1 / 2.5, 1 / 0.4, size=4 * count) / distance
    uv = random.uniform(size=(4 * count, 2))
    points = np.zeros((4 * count, 3), np.float32)
    shade = np.zeros((4 * count, 3), np.float32)
    for index, view in enumerate(views):
        rows = np.flatnonzero(source == index)
        frame, viewmat = view.frames[-1], view.viewmat.numpy().astype(np.float64)
        camera = frame.camera
        x, y = uv[rows, 0] * camera.width, uv[rows, 1] * camera.height
        points[rows] = (camera.rays(x, y) / inverse_depth[rows, None] - viewmat[:3, 3]) @ viewmat[:3, :3]
        shade[rows] = frame.rgb.numpy()[y.astype(np.int64), x.astype(np.int64)].astype(np.float32) / 255
    cameras = np.sum([project(points, view)[1] for view in views], axis=0)
    best = np.sort(np.argsort(-np.minimum(cameras, 1 + len(views) // 3), kind="stable")[:count])
    return points[best], shade[best]


def _viewing_distance(views: tuple[TrainingView, ...]) -> float:
    """Median camera distance to where optical axes meet, else 4 times the spread."""
    positions = np.stack([view.position.numpy() for view in views]).astype(np.float64)
    axes = np.stack([view.viewmat.numpy()[2, :3] for view in views]).astype(np.float64)
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    normal = across.sum(axis=0)
    if len(views) > 1 and np.linalg.cond(normal) < 1e4:
        focus = np.linalg.solve(normal, (across @ positions[:, :, None]).sum(axis=0)[:, 0])
        ahead = ((focus - positions) * axes).sum(axis=1)
        if np.median(ahead) > 0:
            return float(np.median(ahead))
    spread = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    return 4 * spread if spread > 0 else 1.0
