"""Rooms: objects at their places, what is hard about them, and from where photos are taken."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.rooms.models.tableware import Random
from benchmarks.rooms.shapes import F64, Meshes, placed, resting
from fastsplat.service.scene.artefact.scene import SurfaceKind
from fastsplat_contract.geometry.poses import look_at

Build = Callable[[Random], Meshes]

HARD = (
    "touching",
    "crossed",
    "stacked",
    "inside",
    "two materials",
    "thin",
    "hollow",
    "on a pattern",
    "wall",
)
"""What makes objects hard to tell apart or whole: see `Room.hard`."""

_CELL = 0.005
_TRIES = 400


@dataclass(frozen=True)
class Placed:
    """An object in a room, at its place; its label is the detector's word where it has one."""

    label: str
    meshes: Meshes
    surface: SurfaceKind = ""


@dataclass
class Room:
    """Objects in the order of their ids, which count from 1.

    Attributes:
        objects: of the room, surfaces too.
        hard: ids of objects that are hard, by why (see `HARD`); those of a pair or a pile together.
        window: direction to the window.
        poses: float64 [4, 4] each, world from camera, OpenCV axes.
    """

    objects: list[Placed] = field(default_factory=list)
    hard: dict[str, list[tuple[int, ...]]] = field(default_factory=dict)
    window: tuple[float, float, float] = (0.6, -0.5, 0.8)
    poses: list[F64] = field(default_factory=list)

    def put(self, label: str, meshes: Meshes, surface: SurfaceKind = "") -> int:
        """Add an object; its id."""
        self.objects.append(Placed(label, list(meshes), surface))
        return len(self.objects)

    def note(self, why: str, *ids: int) -> None:
        """Say that these objects are hard, and why."""
        assert why in HARD
        self.hard.setdefault(why, []).append(ids)


class Ground:
    """What is left of a level surface with these corners: objects are put where nothing stands yet."""

    def __init__(self, rng: Random, low: tuple[float, float], high: tuple[float, float], height: float = 0.0) -> None:
        self._rng, self._low, self._high, self.height = rng, np.array(low), np.array(high), height
        rows, columns = np.ceil((self._high - self._low)[::-1] / _CELL).astype(int)
        self._taken = np.zeros((rows, columns), np.uint8)

    def place(self, meshes: Meshes, *, gap: float = 0.012, turns: float = np.pi) -> Meshes | None:
        """The meshes, resting somewhere free, turned by up to `turns`; None where no place was left."""
        for _ in range(_TRIES):
            turn = float(self._rng.uniform(-turns, turns))
            moved = self._put(meshes, turn, self._rng.uniform(self._low, self._high), gap)
            if moved is not None:
                return moved
        return None

    def at(self, meshes: Meshes, x: float, y: float, turn: float = 0.0, *, touching: bool = False) -> Meshes:
        """The meshes, resting at this place, which is taken from now on; unless they are to touch what stands beside
        it, it must be free."""
        moved = resting(placed(meshes, x, y, turn), self.height)
        covered = self._covered(moved, 0.0)
        assert touching or not (covered & self._taken).any()
        self._taken |= covered
        return moved

    def _put(self, meshes: Meshes, turn: float, spot: F64, gap: float) -> Meshes | None:
        moved = resting(placed(meshes, float(spot[0]), float(spot[1]), turn), self.height)
        points = np.concatenate([mesh.points[:, :2] for mesh in moved])
        if (points < self._low + 0.01).any() or (points > self._high - 0.01).any():
            return None
        covered = self._covered(moved, gap)
        if (covered & self._taken).any():
            return None
        self._taken |= covered
        return moved

    def _covered(self, meshes: Meshes, gap: float) -> NDArray[np.uint8]:
        points = np.concatenate([mesh.points[:, :2] for mesh in meshes])
        cells = np.round((points - self._low) / _CELL).astype(np.int32)
        covered = np.zeros_like(self._taken)
        cv2.fillConvexPoly(covered, cv2.convexHull(cells[:, None]), 1)
        reach = int(np.ceil(gap / _CELL))
        return np.asarray(cv2.dilate(covered, np.ones((2 * reach + 1,) * 2, np.uint8)), np.uint8)


def extent(meshes: Meshes) -> tuple[F64, F64]:
    """float64 [3], float64 [3]: the lowest and highest corner of what meshes fill."""
    points = np.concatenate([mesh.points for mesh in meshes])
    return points.min(axis=0), points.max(axis=0)


def leaning(meshes: Meshes, reach: float, height: float) -> Meshes:
    """A long object along x whose upper end, `reach` from its lower one, is lifted by `height`: it lies on another."""
    return resting(placed(meshes, roll=-float(np.arcsin(height / reach))))


def arc(
    rng: Random,
    target: tuple[float, float, float],
    rings: Sequence[tuple[float, float, int, float]],
    jitter: float = 0.04,
) -> list[F64]:
    """Poses on rings before a target, as somebody takes photos who walks around it.

    Args:
        rings: each its elevation in degrees, its distance in meters, its number of views and the degrees it reaches to
            either side.
        jitter: meters, of eyes and of what they look at.
    """
    poses = []
    for elevation, distance, count, reach in rings:
        for azimuth in np.radians(np.linspace(-reach, reach, count)):
            a = azimuth + rng.normal(0, 0.02)
            e = np.radians(elevation) + rng.normal(0, 0.03)
            way = np.array([np.sin(a) * np.cos(e), -np.cos(a) * np.cos(e), np.sin(e)])
            eye = np.asarray(target) + distance * rng.uniform(0.92, 1.06) * way + rng.normal(0, jitter / 2, 3)
            poses.append(look_at(eye, np.asarray(target) + rng.normal(0, jitter, 3)))
    return poses
