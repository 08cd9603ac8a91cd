"""Scenes of boxes that are placed on, in, under and beside one another: the placing says where everything is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.artefact.scene import SH_C0, Object, Objects, Scene, SemanticHead
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from tests.query.box_scenes import orbit, with_cameras_moved
from tests.scenes import labelled_scene

F64 = NDArray[np.float64]
Triple = tuple[float, float, float]

_PER_SQUARE_METER = 2_500
_FEWEST, _MOST = 250, 4_000
_NOISE = 0.003
"""Meters: standard deviation of a Gaussian's place off its surface."""
_COLOR_NOISE = 0.03
_WILD = 0.01
"""Share of an object's Gaussians that lie a hand's breadth off, as trained scenes have them."""
_OPACITY = 3.0


@dataclass(frozen=True)
class Slab:
    """A cuboid: corners in meters from the middle of its object's base, before the object is turned."""

    low: Triple
    high: Triple


@dataclass(frozen=True)
class Placed:
    """Slabs on the middle of a base in meters, z up, turned by `yaw` radians about the vertical; sRGB, 0..1."""

    name: str
    slabs: tuple[Slab, ...]
    base: Triple
    yaw: float
    color: Triple

    @property
    def height(self) -> float:
        """Meters."""
        return max(slab.high[2] for slab in self.slabs)


def box(size: Triple) -> tuple[Slab, ...]:
    """One cuboid."""
    x, y, z = size
    return (Slab((-x / 2, -y / 2, 0.0), (x / 2, y / 2, z)),)


def table(size: Triple) -> tuple[Slab, ...]:
    """A top on four legs."""
    x, y, z = size
    inset = 0.08
    feet = [(sx * (x / 2 - inset), sy * (y / 2 - inset)) for sx in (-1, 1) for sy in (-1, 1)]
    legs = [Slab((a - 0.03, b - 0.03, 0.0), (a + 0.03, b + 0.03, z - 0.04)) for a, b in feet]
    return (Slab((-x / 2, -y / 2, z - 0.04), (x / 2, y / 2, z)), *legs)


def crate(size: Triple) -> tuple[Slab, ...]:
    """A box without a lid."""
    x, y, z = size
    wall = 0.02
    return (
        Slab((-x / 2, -y / 2, 0.0), (x / 2, y / 2, wall)),
        Slab((-x / 2, -y / 2, 0.0), (-x / 2 + wall, y / 2, z)),
        Slab((x / 2 - wall, -y / 2, 0.0), (x / 2, y / 2, z)),
        Slab((-x / 2, -y / 2, 0.0), (x / 2, -y / 2 + wall, z)),
        Slab((-x / 2, y / 2 - wall, 0.0), (x / 2, y / 2, z)),
    )


@dataclass
class Room:
    """Objects, in the order of their ids, which count from 1."""

    objects: list[Placed] = field(default_factory=list)

    @classmethod
    def table_with(cls, *objects: tuple[str, Triple]) -> Room:
        """A table, object 1, with flat objects in a row on it."""
        room = cls()
        room.place("table", table((1.4, 0.8, 0.75)), (0, 0, 0), 0.3, (0.72, 0.55, 0.38))
        for (name, color), x in zip(objects, (-0.4, 0.0, 0.4), strict=True):
            room.place(name, box((0.2, 0.15, 0.06)), (x, 0, 0.75), 0.2, color)
        return room

    def place(self, name: str, slabs: Sequence[Slab], base: Sequence[float], yaw: float, color: Sequence[float]) -> int:
        """Put an object there; its id."""
        self.objects.append(
            Placed(name, tuple(slabs), (base[0], base[1], base[2]), yaw, (color[0], color[1], color[2]))
        )
        return len(self.objects)


def scene_of(room: Room, seed: int, world: F64, cameras: bool = True) -> Scene:
    """The room as a trained scene would be: noisy surfaces, nothing where objects stand on each other.

    Args:
        room: the objects.
        seed: of the noise.
        world: float64 [4, 4], rigid: the scene's frame from the room's, so that its vertical is not its z axis.
        cameras: whether it has cameras, which tell what is up.
    """
    rng = np.random.default_rng(seed)
    means, colors, owners, widths = [], [], [], []
    for object_id, obj in enumerate(room.objects, start=1):
        points, width = _surface(obj, rng)
        points = points[~_covered(points, [neighbor for neighbor in room.objects if neighbor is not obj])]
        wild = rng.random(len(points)) < _WILD
        points = points + rng.normal(0, 1, points.shape) * np.where(wild, 0.08, _NOISE)[:, None]
        means.append(points)
        colors.append(np.clip(np.array(obj.color) + rng.normal(0, _COLOR_NOISE, points.shape), 0, 1))
        owners.append(np.full(len(points), object_id, np.int32))
        widths.append(np.full(len(points), width))
    return _trained(
        room, world, *(np.concatenate(arrays) for arrays in (means, colors, owners, widths)), cameras=cameras
    )


def _surface(obj: Placed, rng: np.random.Generator) -> tuple[F64, float]:
    """Points on the slabs' faces, in the room, and how wide a Gaussian is there."""
    sizes = np.array([np.subtract(slab.high, slab.low) for slab in obj.slabs])
    areas = np.stack([sizes[:, 1] * sizes[:, 2], sizes[:, 0] * sizes[:, 2], sizes[:, 0] * sizes[:, 1]], axis=1)
    total = 2 * float(areas.sum())
    count = int(np.clip(total * _PER_SQUARE_METER, _FEWEST, _MOST))
    faces = np.repeat(areas, 2, axis=1)
    choice = rng.choice(faces.size, count, p=(faces / faces.sum()).ravel())
    slab, face = choice // 6, choice % 6
    unit = rng.uniform(0, 1, (count, 3))
    unit[np.arange(count), face // 2] = face % 2
    points = np.array([cuboid.low for cuboid in obj.slabs])[slab] + unit * sizes[slab]
    return points @ _turn(obj.yaw).T + np.array(obj.base), 0.4 * float(np.sqrt(total / count))


def _covered(points: F64, neighbors: Sequence[Placed]) -> NDArray[np.bool_]:
    """bool [K]: points in or against another object, which no camera sees."""
    hidden = np.zeros(len(points), dtype=np.bool_)
    for neighbor in neighbors:
        local = (points - np.array(neighbor.base)) @ _turn(neighbor.yaw)
        for slab in neighbor.slabs:
            hidden |= ((local > np.array(slab.low) - 0.004) & (local < np.array(slab.high) + 0.004)).all(axis=1)
    return hidden


def _turn(yaw: float) -> F64:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _trained(
    room: Room, world: F64, means: F64, colors: F64, owner: NDArray[np.int32], widths: F64, *, cameras: bool
) -> Scene:
    known = tuple(Object(number, obj.name, "person", 1.0) for number, obj in enumerate(room.objects, start=1))
    count = len(means)
    membership = evidence_of(np.arange(count), owner, np.full(count, 16 * UNIT, np.int64), count)
    scene = labelled_scene(
        means @ world[:3, :3].T + world[:3, 3],
        np.zeros(count, int),
        list(dict.fromkeys(obj.name for obj in room.objects)),
        scales=widths[:, None],
        logit_opacities=_OPACITY,
        sh=((colors - 0.5) / SH_C0)[:, None, :],
        cameras=orbit(8, 4.0, 1.6, 0.5) if cameras else (),
        objects=Objects(known, membership),
    )
    return replace(
        with_cameras_moved(scene, world),
        gaussians=replace(scene.gaussians, codes=np.zeros((count, 0), np.float32)),
        head=SemanticHead.unlearnt(len(scene.dictionary)),
        text_encoder=("drawn", "0" * 64),
    )
