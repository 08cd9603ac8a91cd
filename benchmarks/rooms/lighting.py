"""Light of a window and of a bright room around: shadows are soft, because the light comes from many directions.

For every direction it is drawn once how far the light gets; a point is lit from there if nothing lies before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.rooms.rasterizing import Soup, rasterized
from benchmarks.rooms.shapes import F64

F32 = NDArray[np.float32]

_ROOM, _WINDOW = 28, 10
"""Directions of the room's light and of the window's."""
_WINDOW_WIDTH = 0.13
"""Radians, standard deviation of the directions of the window."""
_BOUNCED = 0.16
"""What reaches every point, by walls that are not drawn."""
_ROOM_STRENGTH, _WINDOW_STRENGTH = 0.62, 0.75
_WARM, _COOL = (1.06, 1.0, 0.9), (0.95, 1.0, 1.06)
_AROUND = 0.1
"""Meters around what throws shadows that they reach."""
_COARSE, _FINE = 512, 1024
_LIFT = 0.002
"""Meters, beside a cell of the map, that a point is lifted off its surface, so that it does not shade itself."""


@dataclass(frozen=True)
class Light:
    """How far light gets from each of K directions.

    Attributes:
        toward: float64 [K, 3], unit vectors to where it comes from.
        strength: float64 [K, 3], linear RGB.
        axes: float64 [K, 2, 3], those of each map.
        maps: float32 [side, side] each: how far along `toward` the first surface is.
        low, step: float64 [K, 2]: place of the first cell of each map, and the size of its cells, meters.
        window: unit vector to the middle of the window.
    """

    toward: F64
    strength: F64
    axes: F64
    maps: Sequence[F32]
    low: F64
    step: F64
    window: F64

    def reaching(self, points: F64, normals: F64) -> F32:
        """float32 [N, 3], linear RGB: what falls on a white matt surface at points [N, 3] with unit normals [N, 3]."""
        points, normals = points.astype(np.float32), normals.astype(np.float32)
        sums = np.full((len(points), 3), _BOUNCED, np.float32)
        for k, stored in enumerate(self.maps):
            toward, step = self.toward[k].astype(np.float32), float(self.step[k].max())
            slope = normals @ toward
            rows = np.flatnonzero(slope > 0)
            place = points[rows] + np.float32(_LIFT + step) * normals[rows]
            onto = (self.axes[k] / self.step[k][:, None]).T.astype(np.float32)
            cells = np.floor(place @ onto - (self.low[k] / self.step[k] - 0.5).astype(np.float32)).astype(np.int32)
            inside = ((cells >= 0) & (cells < len(stored))).all(axis=1)
            cells = np.clip(cells, 0, len(stored) - 1)
            free = stored[cells[:, 1], cells[:, 0]] <= place @ toward + np.float32(step)
            lit = rows[free | ~inside]
            sums[lit] += slope[lit, None] * self.strength[k].astype(np.float32)
        return sums


def light_on(soup: Soup, about: F64, window: Sequence[float], seed: int, detail: float = 1.0) -> Light:
    """The light in a room.

    Args:
        soup: what throws shadows.
        about: float64 [N, 3], points around which shadows are drawn; elsewhere all light arrives.
        window: direction to the window's middle.
        seed: of the directions.
        detail: cells of the maps along each side, as a share of the usual.
    """
    rng = np.random.default_rng(seed)
    middle = np.asarray(window, float) / np.linalg.norm(window)
    spread = middle + _WINDOW_WIDTH * rng.standard_normal((_WINDOW, 3))
    number = np.arange(_ROOM) + 0.5
    up = np.sqrt(1 - number / _ROOM * 0.98)  # as many near the zenith as a bright ceiling has
    turn = np.pi * (1 + 5**0.5) * number + rng.uniform(0, 2 * np.pi)
    flat = np.sqrt(1 - up**2)
    room = np.stack([flat * np.cos(turn), flat * np.sin(turn), up], axis=1)
    toward = np.concatenate([room, spread / np.linalg.norm(spread, axis=1, keepdims=True)])
    of_room = np.outer(np.full(_ROOM, _ROOM_STRENGTH / (_ROOM * 0.66)), _COOL)
    strength = np.concatenate([of_room, np.outer(np.full(_WINDOW, _WINDOW_STRENGTH / _WINDOW), _WARM)])
    depth_maps = [
        _map(soup, about, direction, round(detail * (_COARSE if k < _ROOM else _FINE)))
        for k, direction in enumerate(toward)
    ]
    axes, maps, low, step = zip(*depth_maps, strict=True)
    return Light(toward, strength, np.stack(axes), maps, np.stack(low), np.stack(step), middle)


def _map(soup: Soup, about: F64, toward: F64, side: int) -> tuple[F64, F32, F64, F64]:
    first = np.cross(toward, (0.0, 1.0, 0.0) if abs(toward[1]) < 0.9 else (1.0, 0.0, 0.0))
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(toward, first)])
    flat, far = soup.points @ axes.T, soup.points @ toward
    shaded = about @ axes.T
    low, high = shaded.min(axis=0) - _AROUND, shaded.max(axis=0) + _AROUND
    step = np.maximum((high - low) / (side - 1), 1e-6)
    floor, ceiling = float(far.min()) - 1e-3, float(far.max())
    projected = np.concatenate([(flat - low) / step, (far - floor)[:, None]], axis=1)
    hits = rasterized(projected, soup.triangles, np.ones(len(soup.triangles), np.bool_), (side, side))
    depth = np.where(hits.nearness > 0, hits.nearness + floor, floor - (ceiling - floor))
    return axes, depth.astype(np.float32), low, step
