"""Boxes on a floor as cameras see them: exact depth, by rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fastsplat.service.query.surfaces.surface_views import SurfaceView
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.poses import look_at

CAMERA = Camera(120, 90, 70.0, 70.0, 60.0, 45.0)


@dataclass(frozen=True)
class Solid:
    """A cuboid with its sides along the axes, from `low` to `high`, of the object `obj`."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    object_id: int


def floor(half: float = 3.0, obj: int = 9) -> Solid:
    """A slab whose upper side is z = 0."""
    return Solid((-half, -half, -0.5), (half, half, 0.0), obj)


def turned(angle: float, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """The motion that turns about z by `angle` radians, then moves."""
    motion = np.eye(4)
    motion[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    motion[:3, 3] = x, y, z
    return motion


def around(radius: float = 2.6, height: float = 1.6, count: int = 10) -> list[np.ndarray]:
    """Poses of level cameras on a circle that look down at the middle."""
    poses = []
    for angle in np.arange(count) * 2 * np.pi / count + 0.1:
        eye = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
        poses.append(look_at(eye, (0, 0, 0)))
    return poses


def views_of(
    solids: Sequence[Solid], poses: Sequence[np.ndarray] | None = None, motion: np.ndarray | None = None
) -> list[SurfaceView]:
    """What cameras of `poses` show of the solids, all moved by `motion`."""
    return [_view(solids, pose, np.eye(4) if motion is None else motion) for pose in poses or around()]


def _view(solids: Sequence[Solid], pose: np.ndarray, motion: np.ndarray) -> SurfaceView:
    columns, rows = np.meshgrid(np.arange(CAMERA.width) + 0.5, np.arange(CAMERA.height) + 0.5)
    rays = CAMERA.rays(columns.ravel(), rows.ravel()) @ pose[:3, :3].T
    eye = pose[:3, 3]
    depth = np.full(len(rays), np.inf)
    objects, normals = np.zeros(len(rays), np.uint16), np.zeros((len(rays), 3))
    for solid in solids:
        with np.errstate(divide="ignore"):
            ends = (np.stack([solid.low, solid.high])[:, None, :] - eye) / rays
        enter, leave = ends.min(axis=0), ends.max(axis=0)
        first = enter.max(axis=1)
        nearer = (first < leave.min(axis=1)) & (first > 0) & (first < depth)
        depth[nearer], objects[nearer] = first[nearer], solid.object_id
        side = enter.argmax(axis=1)[nearer]
        normals[nearer] = -np.eye(3)[side] * np.sign(rays[nearer, side])[:, None]
    shape = (CAMERA.height, CAMERA.width)
    return SurfaceView(
        posed=PosedCamera(CAMERA, motion @ pose, "a.png"),
        depth=np.where(np.isfinite(depth), depth, 0).astype(np.float32).reshape(shape),
        normals=(normals @ motion[:3, :3].T).astype(np.float16).reshape(*shape, 3),
        confidence=np.isfinite(depth).astype(np.float16).reshape(shape),
        colors=np.zeros((*shape, 3), np.uint8),
        objects=objects.reshape(shape),
        labels=np.zeros(shape, np.uint16),
    )
