"""Two rooms whose layout is known: a kitchen and a study, as they were placed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import minimize

from benchmarks.relations.questions import COLORS
from tests.query.box_scenes import rigid
from tests.query.placed_rooms import F64, Placed, Room, Slab, Triple, box, crate, table


@dataclass(frozen=True)
class Layout:
    """A room and what a question's truth needs of it.

    Attributes:
        name: of the room.
        room: its objects.
        world: float64 [4, 4], rigid: the scene's frame from the room's.
        ids: of the objects, by key: the name, with a number from 2 on where several bear it ("mug", "mug 2").
    """

    name: str
    room: Room
    world: F64
    ids: Mapping[str, int]

    def bearing(self, name: str) -> frozenset[int]:
        """Ids of the objects of this name."""
        return frozenset(number for number, obj in enumerate(self.room.objects, start=1) if obj.name == name)

    def center(self, number: int) -> F64:
        """float64 [3], meters, in the scene's frame: the middle of the box around an object."""
        obj = self.room.objects[number - 1]
        return _into(self.world, _into(_pose(obj), np.mean(_bounds(obj.slabs), axis=0)))

    def size(self, number: int) -> F64:
        """float64 [3], meters: the edges of the box around an object, shortest first."""
        low, high = _bounds(self.room.objects[number - 1].slabs)
        return np.sort(high - low)

    def distance(self, first: int, second: int) -> float:
        """Meters, the shortest way from the surface of an object to that of another."""
        objects = self.room.objects[first - 1], self.room.objects[second - 1]
        return min(_apart(objects[0], a, objects[1], b) for a, b in product(objects[0].slabs, objects[1].slabs))


def layouts() -> tuple[Layout, Layout]:
    """The two rooms."""
    return _layout("kitchen", _kitchen(), 1), _layout("study", _study(), 2)


def _kitchen() -> Room:
    room = Room()
    _put(room, "dining table", table((1.5, 0.9, 0.74)), (0.0, 0.0, 0.0), 0.2, "brown")
    _put(room, "sideboard", box((1.4, 0.45, 0.9)), (0.1, 1.9, 0.0), 0.05, "white")
    _put(room, "refrigerator", box((0.7, 0.6, 1.7)), (2.2, 1.3, 0.0), -0.4, "white")
    _put(room, "basket", crate((0.6, 0.45, 0.3)), (-1.9, -1.1, 0.0), 0.3, "brown")
    for spot in ((-1.25, 0.1), (1.3, 0.35), (0.1, -1.05)):
        _put(room, "chair", box((0.45, 0.38, 0.47)), (*spot, 0.0), 0.4, "black")
    _put(room, "trash can", box((0.34, 0.26, 0.6)), (-1.9, 1.4, 0.0), 0.2, "green")
    for x, y, paint in ((-0.55, 0.05, "red"), (-0.35, -0.2, "blue"), (0.3, 0.3, "yellow")):
        _put(room, "mug", box((0.10, 0.08, 0.10)), (x, y, 0.74), 0.7, paint)
    _put(room, "plate", box((0.24, 0.20, 0.025)), (0.0, 0.0, 0.74), 0.1, "white")
    _put(room, "bread", box((0.28, 0.12, 0.11)), (0.45, -0.05, 0.74), 0.9, "orange")
    _put(room, "toaster", box((0.30, 0.18, 0.20)), (-0.4, 1.9, 0.9), 0.1, "red")
    _put(room, "kettle", box((0.22, 0.16, 0.25)), (0.0, 1.9, 0.9), 0.3, "black")
    _put(room, "bottle", box((0.09, 0.08, 0.31)), (0.35, 1.95, 0.9), 0.3, "green")
    _put(room, "bottle", box((0.08, 0.07, 0.22)), (0.6, 1.95, 0.9), 0.3, "purple")
    _put(room, "potato", box((0.11, 0.07, 0.06)), (-2.0, -1.1, 0.021), 0.3, "yellow")
    _put(room, "onion", box((0.08, 0.07, 0.07)), (-1.75, -1.05, 0.021), 1.1, "purple")
    for x in (-0.25, 0.3):
        _put(room, "shoe", box((0.29, 0.11, 0.10)), (x, 0.05, 0.0), 0.5, "blue")
    return room


def _study() -> Room:
    room = Room()
    _put(room, "desk", table((1.6, 0.85, 0.73)), (0.0, 0.9, 0.0), -0.1, "brown")
    _put(room, "bench", box((2.2, 0.45, 0.45)), (0.0, -1.6, 0.0), 0.0, "brown")
    _put(room, "bookcase", box((0.95, 0.36, 1.2)), (-2.2, 0.9, 0.0), 0.3, "white")
    _put(room, "sofa", box((0.85, 1.7, 0.7)), (2.3, -0.2, 0.0), 0.1, "blue")
    _put(room, "box", crate((0.55, 0.45, 0.32)), (-2.1, -0.7, 0.0), 0.2, "yellow")
    _put(room, "office chair", box((0.52, 0.44, 0.5)), (0.1, -0.1, 0.0), 0.4, "black")
    _put(room, "monitor", box((0.56, 0.10, 0.40)), (0.0, 1.1, 0.73), -0.1, "black")
    _put(room, "keyboard", box((0.44, 0.14, 0.03)), (0.0, 0.75, 0.73), -0.1, "white")
    _put(room, "lamp", box((0.18, 0.14, 0.45)), (-0.6, 1.05, 0.73), 0.4, "red")
    _put(room, "telephone", box((0.20, 0.16, 0.08)), (0.55, 0.8, 0.73), 0.2, "green")
    _put(room, "globe", box((0.26, 0.22, 0.34)), (-2.4, 0.85, 1.2), 0.3, "blue")
    _put(room, "clock", box((0.18, 0.09, 0.16)), (-2.0, 0.95, 1.2), 0.3, "orange")
    for x, scale, paint in ((-0.8, 1.0, "red"), (-0.3, 1.6, "blue"), (0.2, 0.8, "yellow"), (0.7, 1.25, "green")):
        _put(room, "book", box((0.22 * scale, 0.16 * scale, 0.05 * scale)), (x, -1.6, 0.45), 0.2, paint)
    _put(room, "backpack", box((0.34, 0.22, 0.42)), (0.45, 0.85, 0.0), 0.3, "purple")
    _put(room, "umbrella", box((0.44, 0.06, 0.06)), (-2.1, -0.6, 0.021), 0.2, "black")
    _put(room, "ball", box((0.18, 0.16, 0.16)), (-2.05, -0.78, 0.021), 0.2, "orange")
    _put(room, "printer", box((0.46, 0.38, 0.26)), (1.4, 1.7, 0.0), 0.5, "white")
    _put(room, "wastebasket", box((0.28, 0.24, 0.33)), (1.35, 0.6, 0.0), 0.1, "red")
    return room


def _put(room: Room, name: str, slabs: tuple[Slab, ...], base: Triple, yaw: float, paint: str) -> None:
    room.place(name, slabs, base, yaw, COLORS[paint])


def _layout(name: str, room: Room, seed: int) -> Layout:
    ids: dict[str, int] = {}
    for number, obj in enumerate(room.objects, start=1):
        same = sum(previous.name == obj.name for previous in room.objects[:number])
        ids[obj.name if same == 1 else f"{obj.name} {same}"] = number
    return Layout(name, room, rigid(np.random.default_rng(seed)), ids)


def _bounds(slabs: tuple[Slab, ...]) -> tuple[F64, F64]:
    return np.min([slab.low for slab in slabs], axis=0), np.max([slab.high for slab in slabs], axis=0)


def _pose(obj: Placed) -> F64:
    c, s = np.cos(obj.yaw), np.sin(obj.yaw)
    pose = np.eye(4)
    pose[:2, :2] = [[c, -s], [s, c]]
    pose[:3, 3] = obj.base
    return pose


def _into(pose: F64, point: F64) -> F64:
    return np.asarray(pose[:3, :3] @ point + pose[:3, 3])


def _apart(obj: Placed, slab: Slab, other_obj: Placed, other_slab: Slab) -> float:
    """Distance of two cuboids: the least of a convex square over the places in both."""
    ends = [
        (_into(_pose(whole), np.array(part.low)), _pose(whole)[:3, :3] * np.subtract(part.high, part.low))
        for whole, part in ((obj, slab), (other_obj, other_slab))
    ]
    (start, edges), (other_start, other_edges) = ends
    map_to_offset = np.hstack([edges, -other_edges])

    def squared(unit: F64) -> tuple[float, F64]:
        offset = start - other_start + map_to_offset @ unit
        return float(offset @ offset), 2 * map_to_offset.T @ offset

    least = minimize(squared, np.full(6, 0.5), jac=True, method="L-BFGS-B", bounds=[(0, 1)] * 6)
    return float(np.sqrt(least.fun))
