"""Floors, walls, ceilings and the tops of tables that nothing has named: what a question calls them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.things.thing_measures import ThingMeasures
from fastsplat.service.scene.types import SurfaceKind, Thing

_WORDS: Mapping[SurfaceKind, str] = {
    "floor": "floor, ground",
    "wall": "wall",
    "ceiling": "ceiling",
    "horizontal surface": "table, desk, counter, countertop, tabletop, worktop, surface",
}
_KINDS: Mapping[str, SurfaceKind] = {word: kind for kind, words in _WORDS.items() for word in words.split(", ")}
_SIDES: tuple[SurfaceKind, ...] = ("floor", "wall", "ceiling")
"""What bounds a room, and is no thing in it."""
_LARGE = 0.5
"""What is smaller than this share of the largest of its kind is a picture on a wall, or a book on a table."""


def surface_kind(noun: str) -> SurfaceKind:
    """What a noun calls a surface by; "" for none."""
    return _KINDS.get(label_key(noun), "")


def unnamed_surfaces(kind: SurfaceKind, things: Sequence[Thing], measures: ThingMeasures) -> tuple[int, ...]:
    """The ids of the surfaces of a kind that bear no name, without those that are small beside the largest of them; of
    horizontal ones the largest alone, as a table may be in any of them."""
    sizes = {}
    for thing in things:
        shape = measures.shape(thing.id) if thing.surface == kind and not thing.name else None
        if shape is not None:
            sizes[thing.id] = float(np.linalg.norm(shape.size))
    most = max(sizes.values(), default=0.0)
    least = most if kind == "horizontal surface" else _LARGE * most
    return tuple(thing_id for thing_id, size in sizes.items() if size >= least)


def things_in_room(things: Sequence[Thing], measures: ThingMeasures) -> tuple[int, ...]:
    """The ids of all things but floors, walls and ceilings without a name."""
    sides = {thing_id for kind in _SIDES for thing_id in unnamed_surfaces(kind, things, measures)}
    return tuple(thing.id for thing in things if thing.id not in sides)
