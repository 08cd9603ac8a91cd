"""Photos of rooms that are made of flat rectangles with pictures on them: at a phone's size in a second each."""

from __future__ import annotations

import cv2
import numpy as np

from benchmarks.rooms.arranging import Room
from benchmarks.rooms.materials import F32
from benchmarks.rooms.shapes import F64, Mesh
from benchmarks.rooms.truth import RoomView
from fastsplat_contract.geometry.camera import PosedCamera

_MOST_TEXELS = 800
"""Along either side of a rectangle."""
_FINER = 1.5
"""Texels a pixel that a picture is reduced to before it is drawn."""
_AMBIENT = 0.4
_ENDS = ((0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0))
"""The uv of a picture's corners, from the top left clockwise."""


class FlatStudio:
    """A room of rectangles, ready to be photographed. Light comes from the window and from everywhere; nothing throws
    a shadow.

    Args:
        room: each of its meshes is a `shapes.sheet`.
        texels: of painted pictures, a meter.
    """

    def __init__(self, room: Room, texels: float) -> None:
        window = np.asarray(room.window) / np.linalg.norm(room.window)
        self._sheets: list[tuple[int, F64, F32]] = []
        for number, obj in enumerate(room.objects, start=1):
            for mesh in obj.meshes:
                corners = np.array([mesh.points[np.abs(mesh.uv - end).sum(axis=1).argmin()] for end in _ENDS])
                across, down = corners[1] - corners[0], corners[3] - corners[0]
                normal = np.cross(across, down) / np.linalg.norm(np.cross(across, down))
                light = _AMBIENT + (1 - _AMBIENT) * abs(float(normal @ window))
                size = [
                    max(2, min(round(float(np.linalg.norm(side)) * texels), _MOST_TEXELS)) for side in (across, down)
                ]
                self._sheets.append((number, corners, light * _picture(mesh, corners, (size[0], size[1]))))

    def draw(self, posed: PosedCamera) -> RoomView:
        """A view; all rectangles must lie wholly before the camera or behind it."""
        camera, transform = posed.camera, posed.camera_from_world()
        size = (camera.height, camera.width)
        light, objects, nearest = np.full((*size, 3), 0.1, np.float32), np.zeros(size, np.uint8), np.zeros(size)
        for number, corners, picture in self._sheets:
            camera_points = corners @ transform[:3, :3].T + transform[:3, 3]
            if camera_points[:, 2].min() < 0.05:
                continue
            pixels = camera_points[:, :2] / camera_points[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy) - 0.5
            low = np.clip(np.floor(pixels.min(axis=0)), 0, np.array(size[::-1])).astype(int)
            high = np.clip(np.ceil(pixels.max(axis=0)) + 1, 0, np.array(size[::-1])).astype(int)
            if (high <= low).any():
                continue
            box = (slice(low[1], high[1]), slice(low[0], high[0]))
            shape = (int(high[1] - low[1]), int(high[0] - low[0]))
            inside = np.zeros(shape, np.uint8)
            cv2.fillConvexPoly(inside, np.round(16 * (pixels - low)).astype(np.int32), 1, shift=4)
            plane = np.linalg.lstsq(np.column_stack([pixels - low, np.ones(4)]), 1 / camera_points[:, 2], rcond=None)[0]
            nearness = plane[0] * np.arange(shape[1]) + plane[1] * np.arange(shape[0])[:, None] + plane[2]
            first = (inside > 0) & (nearness > nearest[box])
            if first.any():
                drawn = _warped(picture, (pixels - low).astype(np.float32), shape)
                light[box][first], objects[box][first], nearest[box][first] = drawn[first], number, nearness[first]
        return RoomView(posed, light, objects, np.zeros_like(objects), nearest)


def _picture(mesh: Mesh, corners: F64, size: tuple[int, int]) -> F32:
    """float32 [H, W, 3], linear: what is on a rectangle, its top left corner first."""
    width, height = size
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    a, b, _, d = corners
    points = a + u.reshape(-1, 1) * (b - a) + v.reshape(-1, 1) * (d - a)
    uv = np.stack([u.ravel(), 1 - v.ravel()], axis=1)
    color = mesh.material.color(points.astype(np.float32), uv.astype(np.float32))
    return np.asarray(color, np.float32).reshape(height, width, 3)


def _warped(picture: F32, corners: F32, shape: tuple[int, int]) -> F32:
    """float32 [H, W, 3]: a picture seen with its corners, from the top left clockwise, at these pixels."""
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
    width, height = (float(max(sides[side], sides[side + 2])) * _FINER for side in (0, 1))
    size = (int(np.clip(width, 2, picture.shape[1])), int(np.clip(height, 2, picture.shape[0])))
    reduced = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    ends = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32) * size - 0.5
    matrix = cv2.getPerspectiveTransform(ends.astype(np.float32), corners)
    drawn = cv2.warpPerspective(reduced, matrix, shape[::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(drawn, np.float32)
