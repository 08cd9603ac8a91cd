"""Possible hiding places: closed objects and the room that an object needs."""

from __future__ import annotations

from collections.abc import Mapping

from fastsplat.service.query.language.meaning.common_objects import common_objects
from fastsplat.service.query.objects.absence import USUAL_M, Hollow, UnseenSpace

_SHUT = frozenset({"storage", "cabinet", "closet", "drawer", "box", "luggage", "white good"})
"""Kinds of objects that others are kept in, see `common_objects`; they may stand open."""
_FURNITURE = frozenset(
    {"furniture", "white good", "bathroom fixture", "part of a building", "room", "structure", "nature", "landscape"}
    | {"street furniture"}
)
_LARGE = _FURNITURE | {"vehicle", "wild animal", "farm animal"}
_LARGE_M = 0.8
"""Ball width for large objects, meters; a stool needs less, a car more."""


def is_kept_shut(name: str) -> bool:
    """True if such objects can enclose others; nameless ones may, unknown names do not."""
    return not name or any(_SHUT & obj.kinds for obj in common_objects(name)[0])


def width_needed(text: str) -> float:
    """Width of the ball that an object needs, meters, by its kind if known."""
    return _LARGE_M if any(_LARGE & obj.kinds for obj in common_objects(text)[0]) else USUAL_M


def is_furniture(text: str) -> bool:
    """True if a text names something of furniture size, except vehicles and animals."""
    return any(_FURNITURE & obj.kinds for obj in common_objects(text)[0])


def may_hold(unseen: UnseenSpace, text: str, taken_for: Mapping[int, str]) -> tuple[Hollow, ...]:
    """Unseen insides of objects where `text` ("": of usual size) may be, largest first."""
    width = width_needed(text) * unseen.meter
    wide = (hollow for hollow in unseen.hollows if hollow.width >= width and hollow.object_id in taken_for)
    return tuple(hollow for hollow in wide if is_kept_shut(taken_for[hollow.object_id]))
