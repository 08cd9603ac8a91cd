"""A corner of a room whose walls are covered with drawn patterns, as Gaussians, and cameras in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat.service.query.drawing.scene_renderer import Renderer
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.scene.artefact.scene import SH_C0, Scene
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.poses import look_at
from tests.scenes import labelled_scene

CAMERA = Camera(480, 360, 420.0, 420.0, 240.0, 180.0)
WALLS = ("left wall", "back wall", "floor")
_SIDE = 110
_LENGTH = 2.0


def textured_room(
    seed: int = 0, *, block: bool = False, cameras: int = 8, labels: Sequence[str] = WALLS, **options: Any
) -> Scene:
    """Three walls of two units that meet in the origin, patterned by `seed`; `block`: a cube (fourth label, if any)."""
    rng = np.random.default_rng(seed)
    steps = (np.arange(_SIDE) + 0.5) * _LENGTH / _SIDE
    across, down = np.meshgrid(steps, steps, indexing="ij")
    points, colors = [], []
    for axis in range(3):
        wall = np.zeros((_SIDE * _SIDE, 3))
        wall[:, (axis + 1) % 3], wall[:, (axis + 2) % 3] = across.ravel(), down.ravel()
        points.append(wall)
        colors.append(_pattern(rng).reshape(-1, 3))
    if block:
        cells = np.stack(np.meshgrid(*[np.arange(16)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        shell = cells[(cells == 0).any(axis=1) | (cells == 15).any(axis=1)]
        points.append(np.array([0.8, 0.8, 0.02]) + shell * 0.03)
        colors.append(np.broadcast_to([0.95, 0.9, 0.1], (len(shell), 3)))
    means, rgb = np.concatenate(points), np.concatenate(colors)
    ids = np.concatenate([np.full(len(part), row + 1) for row, part in enumerate(points)])
    return labelled_scene(
        means,
        np.minimum(ids, len(labels)),
        labels,
        scales=0.6 * _LENGTH / _SIDE,
        sh=((rgb - 0.5) / SH_C0)[:, None, :],
        logit_opacities=8.0,
        cameras=[looking(angle, name=f"{number}.png") for number, angle in enumerate(np.linspace(-0.4, 0.4, cameras))],
        **options,
    )


def looking(angle: float, *, height: float = 1.3, away: float = 2.7, name: str = "") -> PosedCamera:
    """A camera `away` units from the corner's middle, turned by `angle` radians about the vertical."""
    middle = np.array([0.7, 0.7, 0.5])
    direction = np.pi / 4 + angle
    center = middle + away * np.array([np.cos(direction), np.sin(direction), 0.0]) + [0, 0, height - 0.5]
    return PosedCamera(CAMERA, look_at(center, middle), name)


def renderer(scene: Scene) -> Renderer:
    return Renderer(scene, QuerySettings())


def _pattern(rng: np.random.Generator) -> np.ndarray:
    """float64 [side, side, 3]: blots of several sizes, each of one color."""
    pattern = np.full((_SIDE, _SIDE, 3), 0.5, np.float32)
    for size in (12, 6, 3):
        for _ in range(60 * 12 // size):
            at = rng.integers(0, _SIDE, 2).tolist()
            color = rng.uniform(0.1, 0.9, 3).tolist()
            if rng.random() < 0.5:
                cv2.circle(pattern, at, int(size), color, -1)
            else:
                cv2.rectangle(pattern, at, (at[0] + int(size), at[1] + int(size)), color, -1)
    return pattern.astype(np.float64)


def through_lens(picture: NDArray[np.uint8], k1: float) -> NDArray[np.uint8]:
    """The picture as a lens of that distortion would have made it."""
    height, width = picture.shape[:2]
    lens = pycolmap.Camera(
        model="SIMPLE_RADIAL", width=width, height=height, params=[CAMERA.fx, CAMERA.cx, CAMERA.cy, k1]
    )
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    straight = np.asarray(lens.cam_from_img(np.column_stack([x.ravel(), y.ravel()])))[:, :2]
    pixels = (straight * CAMERA.fx + [CAMERA.cx - 0.5, CAMERA.cy - 0.5]).astype(np.float32)
    return np.asarray(cv2.remap(picture, pixels.reshape(height, width, 2), None, cv2.INTER_LINEAR))
