"""Names that things may have and that nobody has settled, with who says so."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

MOST_SUGGESTED = 5
"""Names that one source may suggest for one thing."""


class Suggestion(NamedTuple):
    """A name that a thing may have.

    Attributes:
        name: one line.
        probability: 0..1, as its source says.
        source: who says so; "" is what the scene's own models and likenesses say.
        model: of the source; "" where it named none.
        aliases: other words for the name.
    """

    name: str
    probability: float
    source: str = ""
    model: str = ""
    aliases: tuple[str, ...] = ()


class SaidName(NamedTuple):
    """What a source said of a thing that a person named: how probable one of its names was, and whether it was the
    person's."""

    source: str
    probability: float
    right: bool


def ranked_suggestions(suggestions: Iterable[Suggestion]) -> tuple[Suggestion, ...]:
    """The most probable ones of each source, the most probable first."""
    kept: list[Suggestion] = []
    for each in sorted(suggestions, key=lambda one: -one.probability):
        if sum(other.source == each.source for other in kept) < MOST_SUGGESTED:
            kept.append(each)
    return tuple(kept)
