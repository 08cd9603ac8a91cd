"""Photos of a made room with a known truth: textured walls, floor and ceiling, and boards that stand in it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

_WIDTH, _HEIGHT, _FOCAL = 800, 600, 560.0
_SIDE, _TALL = 6.0, 3.0
_TEXELS = 1024
_BOARDS = 8
_RADIUS = 1.5


@dataclass(frozen=True, eq=False)
class _Board:
    """A textured parallelogram: points origin + a·first + b·second, with a and b in 0..1."""

    origin: NDArray[np.float64]
    first: NDArray[np.float64]
    second: NDArray[np.float64]
    texture: NDArray[np.uint8]


def write_photos(folder: Path, count: int, seed: int = 0) -> dict[str, NDArray[np.float64]]:
    """Write photos of a walk around the room, looking outwards; returns world_from_camera [4, 4] by file name."""
    rng = np.random.default_rng(seed)
    boards = _room(rng)
    poses = {}
    for index in range(count):
        angle = 2 * np.pi * index / count
        center = np.array([_RADIUS * np.cos(angle), _RADIUS * np.sin(angle), 1.5 + 0.3 * np.sin(5 * angle)])
        pose = _looking(center, angle + 0.25 * np.sin(7 * angle), 0.15 * np.cos(3 * angle))
        name = f"{index:04d}.png"
        cv2.imwrite(str(folder / name), _photo(boards, pose, rng))
        poses[name] = pose
    return poses


def _room(rng: np.random.Generator) -> list[_Board]:
    half = _SIDE / 2
    x, y, up = np.diag([_SIDE, _SIDE, _TALL])
    corner = np.array([-half, -half, 0.0])
    planes = [(corner, x, up), (corner + y, x, up), (corner, y, up), (corner + x, y, up), (corner, x, y)]
    planes.append((corner + up, x, y))
    for number in range(_BOARDS):
        angle = 2 * np.pi * (number + 0.3) / _BOARDS
        middle = np.array([2.4 * np.cos(angle), 2.4 * np.sin(angle), 0.4])
        turned = angle + rng.uniform(0.9, 2.2)
        planes.append((middle, 0.8 * np.array([np.cos(turned), np.sin(turned), 0.0]), np.array([0.0, 0.0, 1.2])))
    return [_Board(*plane, texture=_texture(rng)) for plane in planes]


def _texture(rng: np.random.Generator) -> NDArray[np.uint8]:
    """Noise of several sizes, so that there are features at every distance."""
    picture = np.zeros((_TEXELS, _TEXELS, 3), np.float32)
    for cells in (8, 32, 128, 512):
        coarse = rng.normal(0, 40, (cells, cells, 3)).astype(np.float32)
        picture += cv2.resize(coarse, (_TEXELS, _TEXELS), interpolation=cv2.INTER_CUBIC)
    return np.clip(128 + picture, 0, 255).astype(np.uint8)


def _looking(center: NDArray[np.float64], yaw: float, pitch: float) -> NDArray[np.float64]:
    """world_from_camera [4, 4] of an OpenCV camera in a world with z up."""
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    pose = np.eye(4)
    pose[:3] = np.column_stack([right, np.cross(forward, right), forward, center])
    return pose


def _photo(boards: list[_Board], pose: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.uint8]:
    xs, ys = np.meshgrid(np.arange(_WIDTH) + 0.5, np.arange(_HEIGHT) + 0.5)
    rays = np.stack([(xs - _WIDTH / 2) / _FOCAL, (ys - _HEIGHT / 2) / _FOCAL, np.ones_like(xs)], axis=-1)
    rays = rays @ pose[:3, :3].T
    photo, nearest = np.zeros((_HEIGHT, _WIDTH, 3), np.uint8), np.full((_HEIGHT, _WIDTH), np.inf)
    for board in boards:
        normal = np.cross(board.first, board.second)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = ((board.origin - pose[:3, 3]) @ normal) / (rays @ normal)
        there = pose[:3, 3] + depth[..., None] * rays - board.origin
        a, b = (there @ side / (side @ side) for side in (board.first, board.second))
        shown = (depth > 0) & (depth < nearest) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)
        columns, rows = (np.where(shown, share * _TEXELS, 0).astype(np.float32) for share in (a, b))
        colors = cv2.remap(board.texture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        photo[shown], nearest[shown] = colors[shown], depth[shown]
    return np.clip(photo + rng.normal(0, 2, photo.shape), 0, 255).astype(np.uint8)
