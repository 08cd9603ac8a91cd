"""Groups of objects in rooms: walls, piles, rows, filled vessels, tools across each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.rooms.arranging import Build, Ground, Room, arc, extent, leaning
from benchmarks.rooms.materials import Material, mottled, painted
from benchmarks.rooms.models import office, tableware
from benchmarks.rooms.models.tableware import Random
from benchmarks.rooms.shapes import Meshes, box, placed, resting, sheet
from demo.sample_paint import mural, planks

_TABLE = 0.74
"""Meters, the height of tables and counters."""
_PLASTER = (("#dcd6ca", "#e8e3d9"), ("#c9d2cf", "#d8dfdb"), ("#d9cdb8", "#e6dccb"), ("#bcc6cf", "#ccd4da"))


def before_wall(
    rng: Random, size: tuple[float, float], top: Material, *, wall: Material | None = None, wall_height: float = 1.0
) -> tuple[Room, Ground]:
    """A table whose top is z = 0, a wall behind it, and what is left of the top."""
    room = Room(window=(float(rng.choice([-1, 1])) * float(rng.uniform(0.4, 0.9)), -0.55, 0.85))
    back = size[1] / 2 + 0.004
    put_floor(room, rng, (-4.5, 4.5), back, -_TABLE)
    put_wall(room, rng, (-4.5, back), (4.5, back), (-_TABLE, wall_height), wall)
    legs = [
        mesh
        for x in (-0.45, 0.45)
        for mesh in box((0.05, size[1] - 0.1, _TABLE - 0.035), top, (x * size[0], 0, -_TABLE / 2 - 0.0175))
    ]
    room.put("dining table", [*box((size[0], size[1], 0.035), top, (0, 0, -0.0175)), *legs], "horizontal surface")
    return room, Ground(rng, (-size[0] / 2, -size[1] / 2), (size[0] / 2, size[1] / 2 - 0.02))


def put_corner(room: Room, rng: Random, *, floor: float, back: float, width: float, side: float | None) -> None:
    """A floor of boards, a wall behind, and where `side` is stated, one on the left at that x and one on the right."""
    left, right = -width / 2 if side is None else side, width / 2 + 1
    put_floor(room, rng, (left, right), back, floor)
    put_wall(room, rng, (left, back), (right, back), (floor, 2.5))
    if side is not None:
        put_wall(room, rng, (left, back - 5.0), (left, back), (floor, 2.5))
        put_wall(room, rng, (right, back), (right, back - 5.0), (floor, 2.5))


def put_floor(room: Room, rng: Random, ends: tuple[float, float], back: float, height: float) -> None:
    """Boards from the wall at y = `back` to behind the cameras."""
    (left, right), front = ends, back - 5.0
    corners = [(left, front, height), (right, front, height), (right, back, height), (left, back, height)]
    boards = painted(planks, 1500, 1500, int(rng.integers(1 << 30)), gloss=0.05, polish=30)
    room.put("floor", [sheet(corners, boards, cells=24)], "floor")


def put_wall(
    room: Room,
    rng: Random,
    start: tuple[float, float],
    end: tuple[float, float],
    levels: tuple[float, float],
    material: Material | None = None,
) -> None:
    """A wall from its left end to its right one: of `material`, plaster or wall paper."""
    if material is None and rng.uniform() < 0.5:
        material = painted(mural, 560, 2400, int(rng.integers(1 << 30)), gloss=0.02)
    if material is None:
        material = mottled(_PLASTER[int(rng.integers(len(_PLASTER)))], 9, 1.3, 0.02)
    low, high = levels
    corners = [(*start, low), (*end, low), (*end, high), (*start, high)]
    room.note("wall", room.put("wall", [sheet(corners, material, cells=16)], "wall"))


def photographed(room: Room, rng: Random, target: tuple[float, float, float], distance: float) -> Room:
    rings = ((22, distance, 10, 48), (40, 0.98 * distance, 10, 52), (58, 0.95 * distance, 7, 45))
    room.poses = arc(rng, target, rings)
    return room


def put_more(
    room: Room,
    rng: Random,
    ground: Ground,
    items: Sequence[tuple[str, Build]],
    *,
    turns: float = np.pi,
    area: float = 1.0,
) -> list[int]:
    """Put objects where there is room; the ids of those that found a place."""
    ids = []
    for label, build in items:
        meshes = ground.place(build(rng), turns=turns)
        if meshes is not None:
            ids.append(room.put(label, meshes))
    return ids


def put_thin(room: Room, rng: Random, ground: Ground, items: Sequence[tuple[str, Build]]) -> None:
    for number in put_more(room, rng, ground, items):
        room.note("thin", number)


def put_hollow(room: Room, rng: Random, ground: Ground, items: Sequence[tuple[str, Build]]) -> None:
    for number in put_more(room, rng, ground, items):
        room.note("hollow", number)
        if room.objects[number - 1].label == "cup":
            room.note("two materials", number)


def upon(base: Meshes, meshes: Meshes, rng: Random, turns: float = 0.6) -> Meshes:
    """The meshes on the middle of what lies below, with its turn where they were placed off its middle."""
    low, high = extent(base)
    middle = (low + high) / 2
    spot = placed(meshes, turn=float(rng.uniform(-turns, turns)) if turns else 0.0)
    return resting(placed(spot, float(middle[0]), float(middle[1])), float(high[2]) + 0.0004)


def put_stack(
    room: Room,
    layers: Sequence[tuple[str, Meshes]],
    where: tuple[float, float],
    height: float,
    rng: Random,
    shift: float = 0.012,
) -> list[int]:
    """One on the other, from `height` up, each a little turned."""
    ids = []
    for label, meshes in layers:
        x, y = where + rng.normal(0, shift, 2)
        laid = resting(placed(meshes, float(x), float(y), float(rng.normal(0, 0.25))), height)
        height = float(extent(laid)[1][2]) + 0.0003
        ids.append(room.put(label, laid))
    room.note("stacked", *ids)
    return ids


def put_pile(room: Room, rng: Random, ground: Ground, where: tuple[float, float], count: int) -> None:
    """Books on each other, the widest below."""
    widths = sorted(rng.uniform(0.125, 0.175, count).tolist(), reverse=True)
    books = [("book", office.book(rng, width=width)) for width in widths]
    put_stack(room, books, where, ground.height, rng, 0.006)
    ground.at(office.book(rng, width=0.19), *where)


def put_row(room: Room, rng: Random, ground: Ground, x: float, count: int) -> None:
    """Books that stand beside each other and touch."""
    ids = []
    for _ in range(count):
        upright = office.standing_book(rng)
        low, high = extent(upright)
        wide = float(high[0] - low[0])
        ids.append(room.put("book", ground.at(upright, x + wide / 2, -0.085, touching=True)))
        x += wide + 0.0008
    room.note("touching", *ids)


def put_filled(
    room: Room,
    rng: Random,
    ground: Ground,
    where: tuple[float, float],
    vessel: tuple[str, Meshes],
    count: int,
    items: Sequence[tuple[str, Build]] = (
        ("apple", tableware.apple),
        ("orange", tableware.orange),
        ("lemon", tableware.lemon),
        ("pear", tableware.pear),
        ("apple", tableware.apple),
        ("orange", tableware.orange),
    ),
) -> None:
    """A hollow object with objects in it, which touch it and nearly each other."""
    label, meshes = vessel
    stood = ground.at(meshes, *where, float(rng.uniform(-0.4, 0.4)))
    holder = room.put(label, stood)
    room.note("hollow", holder)
    low, high = extent(stood)
    reach = 0.245 * float((high - low)[:2].min())
    start = float(rng.uniform(0, 6))
    for k in range(count):
        name, build = items[k % len(items)]
        inner = k < 4
        angle = start + 2 * np.pi * k / min(count, 4)
        x, y = (where[0] + reach * np.cos(angle), where[1] + reach * np.sin(angle)) if inner else where
        base = float(low[2]) + (0.02 if inner else 0.06 + 0.035 * (k - 4))
        laid = resting(placed(build(rng), x, y, float(rng.uniform(0, 6))), base)
        room.note("inside", room.put(name, laid), holder)


def put_across(
    room: Room, rng: Random, ground: Ground, low: tuple[str, Build], high: tuple[str, Build], height: float
) -> None:
    """Two long objects: one lies across the other, its end on the ground."""
    below, above = low[1](rng), high[1](rng)
    a, b = extent(above)
    turn = float(rng.uniform(0.9, 1.9)) * (1 if rng.uniform() < 0.5 else -1)
    lying = placed(leaning(above, 0.6 * float(b[0] - a[0]), height), turn=turn)
    marked = ground.place([*resting(below), *lying])
    if marked is None:
        return
    first = room.put(low[0], marked[: len(below)])
    room.note("crossed", first, room.put(high[0], marked[len(below) :]))


def put_flush(room: Room, label: str, meshes: Meshes, back: float) -> None:
    """Put what hangs so that it touches the wall."""
    room.note("thin", room.put(label, placed(meshes, y=back - float(extent(meshes)[1][1]))))


def hung_flat(meshes: Meshes, height: float, back: float) -> Meshes:
    """What lies, hung on a wall at y = `back`."""
    hung = placed(meshes, tip=np.pi / 2, z=height)
    return placed(hung, y=back - float(extent(hung)[1][1]))
