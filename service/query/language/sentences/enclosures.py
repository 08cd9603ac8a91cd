"""Where a thing that nobody saw may be kept: kinds of things that are shut, and how much room it needs."""

from __future__ import annotations

from collections.abc import Mapping

from fastsplat.service.query.language.meaning.common_things import common_things
from fastsplat.service.query.things.absence import USUAL_M, Hollow, UnseenSpace

_SHUT = frozenset({"storage", "cabinet", "closet", "drawer", "box", "luggage", "white good"})
"""Kinds of things that others are kept in, see `common_things`; which of them stand open, photos tell."""
_FURNITURE = frozenset(
    {"furniture", "white good", "bathroom fixture", "part of a building", "room", "structure", "nature", "landscape"}
    | {"street furniture"}
)
_LARGE = _FURNITURE | {"vehicle", "wild animal", "farm animal"}
_LARGE_M = 0.8
"""What things of large kinds need, the width of a ball; a stool needs less, a car more."""


def is_kept_shut(name: str) -> bool:
    """Whether things called so are hollow, and others are kept in them. A thing without a name, "", may be; one whose
    name is not known is taken to be solid."""
    return not name or any(_SHUT & thing.kinds for thing in common_things(name)[0])


def width_needed(text: str) -> float:
    """How wide a ball a place must hold for what is asked for, meters: by its kind, where that is known."""
    return _LARGE_M if any(_LARGE & thing.kinds for thing in common_things(text)[0]) else USUAL_M


def is_furniture(text: str) -> bool:
    """Tells whether a text names something as large as furniture or larger, vehicles and animals aside."""
    return any(_FURNITURE & thing.kinds for thing in common_things(text)[0])


def may_hold(unseen: UnseenSpace, text: str, taken_for: Mapping[int, str]) -> tuple[Hollow, ...]:
    """The insides of things in which what is asked for may be although no photo shows it, the largest first.

    Args:
        unseen: of the scene.
        text: what is asked for; "" for a thing of a usual size.
        taken_for: see `ThingNames`.
    """
    width = width_needed(text) * unseen.meter
    wide = (each for each in unseen.hollows if each.width >= width and each.thing in taken_for)
    return tuple(each for each in wide if is_kept_shut(taken_for[each.thing]))
