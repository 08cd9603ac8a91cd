"""Suggested names of objects that nobody has confirmed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

MOST_SUGGESTED = 5
"""Suggested names per source and object."""


class Suggestion(NamedTuple):
    """A suggested name."""

    name: str  # one line
    probability: float  # 0..1, as stated by the source
    source: str = ""  # "" for the scene's own models and look-alikes
    model: str = ""  # of the source; "" if not stated
    aliases: tuple[str, ...] = ()  # synonyms of the name


class SaidName(NamedTuple):
    """A source's suggestion for an object that a person named."""

    source: str
    probability: float
    right: bool  # one of its names was the person's


def ranked_suggestions(suggestions: Iterable[Suggestion]) -> tuple[Suggestion, ...]:
    """Keeps the `MOST_SUGGESTED` most probable suggestions per source, most probable first."""
    best: list[Suggestion] = []
    for suggestion in sorted(suggestions, key=lambda suggestion: -suggestion.probability):
        if sum(better.source == suggestion.source for better in best) < MOST_SUGGESTED:
            best.append(suggestion)
    return tuple(best)
