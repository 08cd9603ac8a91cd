"""Drawn questions with their truth, which is how objects were placed: nothing here measures a scene.

Each function draws one room and asks some questions about it. A question is either decided by the placing ("put on the
table", "put at the lamp's left as the asker sees it"), or it cannot be decided by it: the asker's place is not said,
objects are equally large or equally far, half way between two directions or two colors, one rests on what rests on the
table.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from fastsplat_contract.geometry.poses import look_at
from tests.query.placed_rooms import F64, Room, box, crate, table

COLORS = {
    "red": (0.75, 0.10, 0.10),
    "green": (0.15, 0.55, 0.20),
    "blue": (0.12, 0.25, 0.75),
    "yellow": (0.92, 0.85, 0.15),
    "white": (0.95, 0.95, 0.93),
    "black": (0.07, 0.07, 0.07),
    "orange": (0.93, 0.50, 0.10),
    "purple": (0.45, 0.15, 0.60),
    "brown": (0.38, 0.23, 0.11),
}
"""Paints."""
_MIXED = (("red", "orange"), ("blue", "purple"), ("yellow", "orange"), ("green", "yellow"))
"""Names between which half of both has no name of its own."""
_WOOD = (0.72, 0.55, 0.38)
_SMALL = {
    "mug": (0.09, 0.09, 0.10),
    "bottle": (0.08, 0.08, 0.25),
    "book": (0.20, 0.15, 0.05),
    "bowl": (0.18, 0.18, 0.08),
    "vase": (0.12, 0.12, 0.22),
    "clock": (0.15, 0.08, 0.16),
}
_STANDING = {"stool": (0.35, 0.35, 0.5), "basket": (0.4, 0.4, 0.35), "plant": (0.35, 0.35, 0.8), "fan": (0.3, 0.3, 0.6)}
_SIDES = {"left of": 180.0, "right of": 0.0, "behind": 90.0, "in front of": -90.0}


@dataclass(frozen=True)
class Case:
    """A question and its truth.

    Attributes:
        text: the question.
        kind: what it is about.
        truth: ids of the objects that it means; None where the placing does not decide it.
        count: how many, for a question for a number.
        asker: float64 [4, 4] in the room, where the asker stands; None if that is not said.
        vertical: whether the scene has cameras, which tell what is up.
    """

    text: str
    kind: str
    truth: frozenset[int] | None
    count: int | None = None
    asker: F64 | None = None
    vertical: bool = True


@dataclass
class Drawn:
    """A room with its questions."""

    room: Room
    cases: list[Case] = field(default_factory=list)

    def ask(
        self, text: str, kind: str, truth: Sequence[int] | None, asker: F64 | None = None, vertical: bool = True
    ) -> None:
        """Add a question for objects."""
        self.cases.append(Case(text, kind, None if truth is None else frozenset(truth), None, asker, vertical))

    def count(self, text: str, kind: str, truth: Sequence[int] | None) -> None:
        """Add a question for a number."""
        known = None if truth is None else frozenset(truth)
        self.cases.append(Case(text, kind, known, None if truth is None else len(truth)))


def stacked_room(rng: np.random.Generator) -> Drawn:
    """Objects on a table, on a cabinet, in a crate and under the table."""
    drawn = Drawn(Room())
    room = drawn.room
    desk = (float(rng.uniform(1.3, 1.6)), float(rng.uniform(0.8, 0.95)), float(rng.uniform(0.68, 0.78)))
    yaw = float(rng.uniform(-0.4, 0.4))
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    room.place("table", table(desk), (0, 0, 0), yaw, _WOOD)
    room.place("cabinet", box((0.6, 0.5, 0.9)), (1.7, 0.2, 0), float(rng.uniform(-0.3, 0.3)), _WOOD)
    room.place("crate", crate((0.6, 0.5, 0.3)), (-1.7, 0.1, 0), float(rng.uniform(-0.3, 0.3)), _WOOD)
    spots = {
        "on the table": [(*(turn @ (x, y)), desk[2]) for x in (-0.45, 0.0, 0.45) for y in (-0.2, 0.2)],
        "on the cabinet": [(1.6, 0.2, 0.9), (1.82, 0.2, 0.9)],
        "in the crate": [(-1.82, 0.1, 0.021), (-1.58, 0.1, 0.021)],
        "under the table": [(*(turn @ (x, 0.0)), 0.0) for x in (-0.3, 0.25)],
    }
    where: dict[str, dict[str, list[int]]] = {}
    paints: dict[int, str] = {}
    for place, free in spots.items():
        taken = rng.permutation(len(free))[: int(rng.integers(1, min(len(free), 4) + 1))]
        for spot in taken:
            name = str(rng.choice(list(_SMALL)))
            x, y, z = free[spot]
            base = (x + float(rng.uniform(-0.02, 0.02)), y + float(rng.uniform(-0.02, 0.02)), z)
            paint = str(rng.choice(list(COLORS)))
            obj = room.place(name, box(_SMALL[name]), base, float(rng.uniform(0, 3)), COLORS[paint])
            paints[obj] = paint
            where.setdefault(place, {}).setdefault(name, []).append(obj)
    for place, named in where.items():
        everything = [obj for group in named.values() for obj in group]
        drawn.ask(f"what is {place}?", place.split()[0], everything)
        drawn.count(f"how many objects are {place}?", "how many", everything)
        for name in sorted({*named, str(rng.choice(list(_SMALL)))} & {obj.name for obj in room.objects}):
            drawn.ask(f"the {name} {place}", place.split()[0], named.get(name, []))
        name = str(rng.choice(list(named)))
        elsewhere = [
            obj for other_place, by_name in where.items() if other_place != place for obj in by_name.get(name, [])
        ]
        drawn.ask(f"{name}s not {place}", "not", elsewhere)
        paint = paints[named[name][0]]
        both = [obj for obj in named[name] if paints[obj] == paint]
        drawn.ask(f"the {paint} {name} that is {place}", "color and place", both)
    _without_answers(drawn, where, rng)
    return drawn


def _without_answers(drawn: Drawn, where: dict[str, dict[str, list[int]]], rng: np.random.Generator) -> None:
    """Questions about a stacked room that its placing does not decide."""
    room = drawn.room
    place = str(rng.choice(["on the table", "on the cabinet"]))
    carrier = next(obj for group in where[place].values() for obj in group)
    below = room.objects[carrier - 1]
    base = (below.base[0], below.base[1], below.base[2] + below.height)
    room.place("toy", box((0.06, 0.06, 0.07)), base, 0.0, COLORS["yellow"])
    drawn.ask(f"the toy {place}", "rests on something between", None)
    name = next(iter(where[place]))
    drawn.ask(f"the {name} {place}", "vertical unknown", None, vertical=False)
    drawn.ask(f"the {name} {place} that we bought last year", "not parsed", None)
    drawn.ask(f"{name} full of water", "not measured", None)
    # What is on the toy's carrier is not directly in that place: whoever counts there has to say so.
    for number, case in enumerate(drawn.cases):
        if case.text in (f"what is {place}?",):
            continue
        if case.text == f"how many objects are {place}?":
            drawn.cases[number] = Case(case.text, "how many", None)


def facing_room(rng: np.random.Generator) -> Drawn:
    """Objects around another one, as somebody sees them from one side or another."""
    drawn = Drawn(Room())
    room = drawn.room
    names = rng.permutation(list(_STANDING)).tolist()
    middle, around = str(names[0]), str(names[1])
    angle = float(rng.uniform(0, 2 * np.pi))
    eye = (3.8 * np.cos(angle), 3.8 * np.sin(angle), 1.5)
    asker = look_at(eye, (float(rng.uniform(-0.3, 0.3)), float(rng.uniform(-0.3, 0.3)), 0.4))
    room.place(middle, box(_STANDING[middle]), (0, 0, 0), float(rng.uniform(0, 3)), _WOOD)
    right = np.array([-np.sin(angle), np.cos(angle)])  # of who looks at the middle
    away = -np.array([np.cos(angle), np.sin(angle)])
    placed: dict[str, int] = {}
    for side in rng.permutation(list(_SIDES))[: int(rng.integers(2, 5))]:
        turned = np.radians(_SIDES[str(side)] + float(rng.uniform(-20, 20)))
        spot = float(rng.uniform(0.9, 1.5)) * (np.cos(turned) * right + np.sin(turned) * away)
        base = (float(spot[0]), float(spot[1]), 0.0)
        placed[str(side)] = room.place(around, box(_STANDING[around]), base, float(rng.uniform(0, 3)), _WOOD)
    for side in _SIDES:
        drawn.ask(f"the {around} {side} the {middle}", side, [placed[side]] if side in placed else [], asker)
    opposite = look_at((-eye[0], -eye[1], 1.5), (0.0, 0.0, 0.4))
    turned_round = {"left of": "right of", "right of": "left of", "behind": "in front of", "in front of": "behind"}
    side = str(rng.choice(list(placed)))
    drawn.ask(
        f"{around} to the {turned_round[side]} the {middle}".replace("to the in", "in").replace(
            "to the behind", "behind"
        ),
        turned_round[side],
        [placed[side]],
        opposite,
    )
    drawn.ask(f"the {around} {side} the {middle}", "pose not said", None)
    if set(placed) & {"left of", "right of"}:
        # Half way between two directions.
        third = str(names[2])
        diagonal = np.radians(float(rng.choice([64.0, 116.0])))
        spot = 1.3 * (np.cos(diagonal) * right - np.sin(diagonal) * away)
        room.place(third, box((0.35, 0.35, 0.4)), (float(spot[0]), float(spot[1]), 0.0), 0.0, _WOOD)
        sign = "right of" if np.cos(diagonal) > 0 else "left of"
        drawn.ask(f"the {third} {sign} the {middle}", "between two directions", None, asker)
    behind = look_at((-0.4 * eye[0], -0.4 * eye[1], 1.5), (-4 * eye[0], -4 * eye[1], 1.0))
    drawn.ask(f"the {around} {side} the {middle}", "behind the asker", None, behind)
    return drawn


def row_room(rng: np.random.Generator) -> Drawn:
    """A row of objects of one name on a long bench: an order, sizes and colors."""
    drawn = Drawn(Room())
    room = drawn.room
    room.place("bench", box((2.6, 0.6, 0.5)), (0, 0, 0), 0.0, _WOOD)
    name = str(rng.choice(["mug", "bottle", "vase", "bowl"]))
    count = int(rng.integers(3, 6))
    scales = rng.permutation(1.0 * 1.28 ** np.arange(count))
    paints = rng.permutation(list(COLORS))[:count].tolist()
    xs = (np.arange(count) - (count - 1) / 2) * 0.48
    row = []
    for x, scale, paint in zip(xs, scales, paints, strict=True):
        size = tuple(float(scale * side) for side in _SMALL[name])
        spot = (float(x), float(rng.uniform(-0.03, 0.03)), 0.5)
        row.append(room.place(name, box((size[0], size[1], size[2])), spot, float(rng.uniform(0, 3)), COLORS[paint]))
    by_size = [row[place] for place in np.argsort(scales)]
    drawn.ask(f"the largest {name}", "size", [by_size[-1]])
    drawn.ask(f"the smallest {name}", "size", [by_size[0]])
    drawn.ask(f"second largest {name}", "size", [by_size[-2]])
    drawn.ask(f"the tallest {name}", "size", [by_size[-1]])
    side = float(rng.choice([-1.0, 1.0]))
    asker = look_at((float(rng.uniform(-0.4, 0.4)), 3.5 * side, 1.5), (0.0, 0.0, 0.5))
    ordered = row if side < 0 else row[::-1]  # from the front (−y) left is −x
    number = int(rng.integers(1, count))
    words = ("first", "second", "third", "fourth", "fifth")
    drawn.ask(f"the {words[number]} {name} from the left", "order", [ordered[number]], asker)
    drawn.ask(f"which {name} is {words[number]} from the right?", "order", [ordered[-1 - number]], asker)
    drawn.ask(f"the leftmost {name}", "order", [ordered[0]], asker)
    drawn.ask(f"{name} on the right", "order", [ordered[-1]], asker)
    drawn.ask(f"the {words[number]} {name} from the left", "pose not said", None)
    for paint in rng.permutation(list(COLORS))[:3].tolist():
        drawn.ask(f"the {paint} {name}", "color", [row[paints.index(paint)]] if paint in paints else [])
    drawn.ask(f"{name}s that are not {paints[0]}", "color", row[1:])
    drawn.count(f"how many {name}s are there?", "how many", row)
    drawn.ask(f"the {name} without a handle", "not measured", None)
    first, second = _MIXED[int(rng.integers(len(_MIXED)))]
    mixed = tuple(float((a + b) / 2) for a, b in zip(COLORS[first], COLORS[second], strict=True))
    room.place("box", box((0.3, 0.3, 0.3)), (0.0, 1.5, 0.0), 0.0, (mixed[0], mixed[1], mixed[2]))
    drawn.ask(f"the {rng.choice([first, second])} box", "between two colors", None)
    for at in (-0.9, 0.9):
        base = (at, -1.6, 0.0)
        room.place("pot", box((0.25 * float(rng.uniform(0.99, 1.01)), 0.25, 0.3)), base, 0.0, COLORS["white"])
    drawn.ask("the largest pot", "equal sizes", None)
    return drawn


def near_room(rng: np.random.Generator) -> Drawn:
    """Objects beside one another, between two, near and far."""
    drawn = Drawn(Room())
    room = drawn.room
    names = [str(name) for name in rng.permutation(list(_STANDING))]
    first, second, third = names[0], names[1], names[2]
    half = float(rng.uniform(1.6, 2.0))
    room.place(first, box(_STANDING[first]), (-half, 0, 0), float(rng.uniform(0, 3)), _WOOD)
    room.place(second, box(_STANDING[second]), (half, 0, 0), float(rng.uniform(0, 3)), _WOOD)
    size = _STANDING[third]
    step = (size[0] + _STANDING[first][0]) / 2 + float(rng.uniform(0.05, 0.2))
    turned = float(rng.uniform(2.0, 4.3))  # beside the first one, on the side away from the second
    spot = (-half + step * float(np.cos(turned)), step * float(np.sin(turned)), 0.0)
    beside = room.place(third, box(size), spot, turned, _WOOD)
    middle = room.place(
        third, box(size), (float(rng.uniform(-0.25, 0.25)), float(rng.uniform(-0.1, 0.1)), 0.0), 0.3, _WOOD
    )
    off = room.place(third, box(size), (half * 0.8, 2.7 * float(rng.choice([-1, 1])), 0.0), 0.3, _WOOD)
    drawn.ask(f"the {third} next to the {first}", "next to", [beside])
    drawn.ask(f"{third}s beside the {second}", "next to", [])
    drawn.ask(f"{third} near the {first}", "near", [beside])
    drawn.ask(f"the {third} between the {first} and the {second}", "between", [middle])
    drawn.ask(f"what is between the {second} and the {first}?", "between", [middle])
    drawn.ask(f"the {third} nearest to the {first}", "nearest", [beside])
    drawn.ask(f"the {third} closest to the {second}", "nearest", [middle])
    drawn.ask(f"the farthest {third} from the {first}", "farthest", [off])
    eye = (-half - 2.0, float(rng.uniform(-0.3, 0.3)), 1.5)
    asker = look_at(eye, (0.0, 0.0, 0.4))
    drawn.ask(f"the nearest {third}", "nearest", [beside], asker)
    drawn.ask(f"the {third} farthest from me", "farthest", [off], asker)
    drawn.ask(f"the nearest {third}", "pose not said", None)
    drawn.ask(f"the {first} next to the {third} between the {first} and the {second}", "next to", [])
    drawn.ask(f"the {second} nearest to the {third}", "several are meant", None)
    last = names[3]
    for sign in (-1.0, 1.0):
        base = (half, sign * 1.2, 0.0)
        room.place(last, box((0.3, 0.3, 0.3)), base, 0.0, _WOOD)
    drawn.ask(f"the {last} nearest to the {second}", "equally far", None)
    return drawn


ROOMS: Sequence[Callable[[np.random.Generator], Drawn]] = (stacked_room, facing_room, row_room, near_room)
"""Each draws a room with its questions."""
