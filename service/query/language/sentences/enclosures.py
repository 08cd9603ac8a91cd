"""Possible hiding places: closed things and the room that a thing needs."""

from __future__ import annotations

from collections.abc import Mapping

from fastsplat.service.query.language.meaning.common_things import common_things
from fastsplat.service.query.things.absence import USUAL_M, Hollow, UnseenSpace

_SHUT = frozenset({"storage", "cabinet", "closet", "drawer", "box", "luggage", "white good"})
"""Kinds of things that others are kept in, see `common_things`; they may stand open."""
_FURNITURE = frozenset(
    {"furniture", "white good", "bathroom fixture", "part of a building", "room", "structure", "nature", "landscape"}
    | {"street furniture"}
)
_LARGE = _FURNITURE | {"vehicle", "wild animal", "farm animal"}
_LARGE_M = 0.8
"""Ball width for large things, meters; a stool needs less, a car more."""


def is_kept_shut(name: str) -> bool:
    """True if such things can enclose others; nameless ones may, unknown names do not."""
    return not name or any(_SHUT & thing.kinds for thing in common_things(name)[0])


def width_needed(text: str) -> float:
    """Width of the ball that a thing needs, meters, by its kind if known."""
    return _LARGE_M if any(_LARGE & thing.kinds for thing in common_things(text)[0]) else USUAL_M


def is_furniture(text: str) -> bool:
    """True if a text names something of furniture size, except vehicles and animals."""
    return any(_FURNITURE & thing.kinds for thing in common_things(text)[0])


def may_hold(unseen: UnseenSpace, text: str, taken_for: Mapping[int, str]) -> tuple[Hollow, ...]:
    """Unseen insides of things where `text` ("": of usual size) may be, largest first."""
    width = width_needed(text) * unseen.meter
    wide = (hollow for hollow in unseen.hollows if hollow.width >= width and hollow.thing in taken_for)
    return tuple(each for each in wide if is_kept_shut(taken_for[each.thing]))
