"""What is true of a drawn room in space: boxes, surfaces that photos show, and silhouettes of objects alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.rooms.arranging import Room
from benchmarks.rooms.rasterizing import Soup, projected_into, rasterized
from benchmarks.rooms.shapes import F64, Ints
from fastsplat_contract.geometry.camera import PosedCamera

_POINTS = 1500
"""Points that are drawn on each object, those included that no photo shows."""
_ARRAYS = ("axes", "low", "high", "points", "owners", "parts")
_WORDS = ("labels", "surfaces", "names", "part_names")
_NEAR = 0.01
"""Share of its depth by which a point that a photo shows may lie behind what is seen there."""


@dataclass(frozen=True)
class RoomView:
    """A view of a room.

    Attributes:
        posed: its camera.
        light: float32 [H, W, 3], linear RGB.
        objects, parts: uint8 [H, W], ids, 0 for none.
        nearness: float64 [H, W], 1 / depth, 0 where nothing is.
    """

    posed: PosedCamera
    light: NDArray[np.float32]
    objects: NDArray[np.uint8]
    parts: NDArray[np.uint8]
    nearness: F64


@dataclass(frozen=True)
class Truth:
    """What is true of N objects in space; meters.

    Attributes:
        labels, surfaces: of each object, see `Placed`.
        axes: float64 [N, 3, 3], rows: the axes of each upright box.
        low, high: float64 [N, 3], its ends along them.
        points: float32 [K, 3], on what training views show.
        owners: int32 [K], the object of each point, from 1.
        names: of the V views to measure by.
        silhouettes: bool [V, N, H, W], what each object would cover if it were alone.
        parts: uint8 [V, H, W], the part that each pixel shows, 0 for none.
        part_names: of each part, from 1.
    """

    labels: tuple[str, ...]
    surfaces: tuple[str, ...]
    axes: F64
    low: F64
    high: F64
    points: NDArray[np.float32]
    owners: NDArray[np.int32]
    names: tuple[str, ...]
    silhouettes: NDArray[np.bool_]
    parts: NDArray[np.uint8]
    part_names: tuple[str, ...]

    def outside(self, obj: int, points: F64, margin: float) -> NDArray[np.bool_]:
        """bool [K]: which points [K, 3] lie farther than `margin`, meters, outside the box of an object, from 1."""
        along = points @ self.axes[obj - 1].T
        beyond = np.maximum(self.low[obj - 1] - along, along - self.high[obj - 1])
        return np.asarray((beyond > margin).any(axis=1))


def truth_of(
    room: Room,
    soup: Soup,
    object_of: Ints,
    part_names: Sequence[str],
    train: Sequence[RoomView],
    test: Sequence[RoomView],
) -> Truth:
    """The truth of a room, whose triangles belong to `object_of` (int64 [T]), by views that show what can be known
    (`train`) and views to measure by (`test`, at least one)."""
    rng = np.random.default_rng(0)
    boxes = [_upright_box(np.concatenate([mesh.points for mesh in obj.meshes])) for obj in room.objects]
    points, owners = [], []
    for number in range(1, len(room.objects) + 1):
        samples = _surface_points(soup, np.flatnonzero(object_of == number), rng)
        seen = np.zeros(len(samples), np.bool_)
        for view in train:
            seen |= _shows(view, samples, number)
        points.append(samples[seen])
        owners.append(np.full(int(seen.sum()), number, np.int32))
    axes, low, high = (np.stack(arrays) for arrays in zip(*boxes, strict=True))
    return Truth(
        labels=tuple(obj.label for obj in room.objects),
        surfaces=tuple(obj.surface for obj in room.objects),
        axes=axes,
        low=low,
        high=high,
        points=np.concatenate(points).astype(np.float32),
        owners=np.concatenate(owners),
        names=tuple(view.posed.name for view in test),
        silhouettes=np.stack([_silhouettes(soup, object_of, len(room.objects), view.posed) for view in test]),
        parts=np.stack([view.parts for view in test]),
        part_names=tuple(part_names),
    )


def write_truth(truth: Truth, path: Path) -> None:
    """As one NPZ, silhouettes as bits."""
    arrays: dict[str, Any] = {name: getattr(truth, name) for name in _ARRAYS}
    arrays |= {name: np.array(getattr(truth, name), dtype=np.str_) for name in _WORDS}
    shape = np.array(truth.silhouettes.shape)
    np.savez_compressed(path, bits=np.packbits(truth.silhouettes), shape=shape, **arrays)


def read_truth(path: Path) -> Truth:
    """What `write_truth` wrote."""
    with np.load(path) as stored:
        shape = stored["shape"]
        bits = np.unpackbits(stored["bits"], count=int(np.prod(shape))).reshape(shape).astype(np.bool_)
        arrays: dict[str, Any] = {name: stored[name] for name in _ARRAYS}
        arrays |= {name: tuple(stored[name].tolist()) for name in _WORDS}
    return Truth(**arrays, silhouettes=bits)


def _upright_box(points: F64) -> tuple[F64, F64, F64]:
    """Axes and ends of the upright box of least area from above."""
    (_, _), (_, _), angle = cv2.minAreaRect(points[:, :2].astype(np.float32))
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    along = points @ axes.T
    return axes, along.min(axis=0), along.max(axis=0)


def _surface_points(soup: Soup, triangles: Ints, rng: np.random.Generator) -> F64:
    a, b, c = (soup.points[soup.triangles[triangles, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    rows = rng.choice(len(triangles), _POINTS, p=area / area.sum())
    u, v = rng.uniform(size=(2, _POINTS, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return np.asarray(a[rows] + u * (b - a)[rows] + v * (c - a)[rows])


def _shows(view: RoomView, points: F64, obj: int) -> NDArray[np.bool_]:
    camera, matrix = view.posed.camera, view.posed.camera_from_world()
    camera_points = points @ matrix[:3, :3].T + matrix[:3, 3]
    depth = np.maximum(camera_points[:, 2], 1e-9)
    column = np.floor(camera.fx * camera_points[:, 0] / depth + camera.cx).astype(np.int64)
    row = np.floor(camera.fy * camera_points[:, 1] / depth + camera.cy).astype(np.int64)
    inside = (camera_points[:, 2] > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    column, row = np.clip(column, 0, camera.width - 1), np.clip(row, 0, camera.height - 1)
    near = depth * view.nearness[row, column] < 1 + _NEAR
    return np.asarray(inside & near & (view.objects[row, column] == obj))


def _silhouettes(soup: Soup, object_of: Ints, count: int, posed: PosedCamera) -> NDArray[np.bool_]:
    """bool [N, H, W]."""
    projected, front, size = projected_into(soup, posed.camera, posed.camera_from_world())
    masks = [front & (object_of == number) for number in range(1, count + 1)]
    return np.stack([rasterized(projected, soup.triangles, drawn, size).triangle >= 0 for drawn in masks])
