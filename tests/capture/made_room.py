"""A made room with textured walls, seen by cameras of any kind: what a ray meets is computed, not rendered."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.photos.lens_faces import face_rays
from fastsplat_contract.geometry.camera import Camera

F64 = NDArray[np.float64]

LOW, HIGH = np.array([-2.5, -2.0, 0.0]), np.array([2.5, 2.0, 2.6])  # corners of the room, meters, z up
_PIXELS_A_METER = 160


@cache
def _texture(face: int) -> NDArray[np.uint8]:
    """Blots of many sizes, of the size of a wall."""
    across = [axis for axis in range(3) if axis != face // 2]
    size = ((HIGH - LOW)[across] * _PIXELS_A_METER).astype(int)
    rng = np.random.default_rng(face)
    image = np.zeros((size[1], size[0], 3), np.float32)
    for cells, weight in ((6, 0.25), (30, 0.75)):
        noise = rng.uniform(0, 255, (cells, cells, 3)).astype(np.float32)
        image += weight * cv2.resize(noise, (int(size[0]), int(size[1])), interpolation=cv2.INTER_CUBIC)
    return np.clip((image - 127) * 1.8 + 127, 0, 255).astype(np.uint8)


def look(origin: F64, directions: F64) -> NDArray[np.uint8]:
    """uint8 [..., 3]: colors that rays [..., 3] from `origin` [3] meet."""
    flat = directions.reshape(-1, 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        times = np.where(flat > 0, (HIGH - origin) / flat, (LOW - origin) / flat)
    times[~np.isfinite(times)] = np.inf
    axis = times.argmin(axis=1)
    points = origin + flat * times[np.arange(len(flat)), axis, None]
    colors = np.zeros((len(flat), 3), np.uint8)
    for face in range(6):
        rows = np.flatnonzero((axis == face // 2) & ((flat[np.arange(len(flat)), axis] > 0) == bool(face % 2)))
        across = [number for number in range(3) if number != face // 2]
        texture = _texture(face)
        at = ((points[rows][:, across] - LOW[across]) * _PIXELS_A_METER - 0.5).astype(np.float32)
        if len(rows):
            pad = -len(rows) % 1024
            x, y = (np.pad(at[:, i], (0, pad)).reshape(-1, 1024) for i in range(2))
            colors[rows] = cv2.remap(texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).reshape(-1, 3)[
                : len(rows)
            ]
    return colors.reshape(directions.shape)


def panorama_rays(width: int) -> F64:
    """float64 [W/2, W, 3] of an equirectangular picture, OpenCV axes, z to its middle."""
    longitude = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    latitude = (0.5 - (np.arange(width // 2) + 0.5) / (width // 2)) * np.pi
    return np.stack(
        np.broadcast_arrays(
            np.cos(latitude)[:, None] * np.sin(longitude),
            -np.sin(latitude)[:, None],
            np.cos(latitude)[:, None] * np.cos(longitude),
        ),
        axis=-1,
    )


def pose(center: tuple[float, float, float], heading_deg: float, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> F64:
    """float64 [4, 4] world_from_camera, OpenCV axes: level at pitch and roll 0, looking along x at heading 0."""
    heading, pitch, roll = np.radians([heading_deg, pitch_deg, roll_deg])
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    turn = np.array([[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]])
    up = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    around = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = turn @ level @ up @ around, center
    return result


def photo(world_from_camera: F64, rays: F64) -> NDArray[np.uint8]:
    """uint8 [H, W, 3] RGB: the room as a camera with these rays [H, W, 3] sees it."""
    return look(world_from_camera[:3, 3], rays @ world_from_camera[:3, :3].T)


def check_picture(picture: NDArray[np.uint8], valid: NDArray[np.bool_], camera: Camera, world_from_camera: F64) -> None:
    """A pinhole's picture [H, W, 3] is the room as seen from there, by its valid pixels [H, W]."""
    expected = photo(world_from_camera, face_rays(camera)).astype(float)
    error, shifted = np.abs(picture - expected), np.abs(np.roll(expected, 4, axis=1) - expected)
    assert error[valid].mean() < 0.4 * shifted[valid].mean()
