"""Merges name suggestions of several sources, weighted by their confirmed accuracy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import prod

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.scene.artefact.scene import NameSource, Object
from fastsplat.service.scene.artefact.suggestions import SaidName, Suggestion

OWN_SOURCE = "detector"
"""Source name of the scene's own models and likenesses."""
TAG_SOURCE = "tag"
"""Source name of printed tags."""
_SETTLED: tuple[NameSource, ...] = ("given", "person")
"""Sources beside whose names no suggestion counts."""
_PRIOR = 4.0
"""Prior weight of a source's own probabilities, in confirmations. Set, not measured."""
_MOST = 0.99
"""Upper bound of a suggestion's probability."""

Trust = Mapping[str, float]
"""Factor for each source's probabilities; 1 if unknown."""


@dataclass(frozen=True)
class MergedName:
    """A suggested name of one object."""

    name: str  # as its likeliest source writes it
    aliases: tuple[str, ...]  # other words for it, of all sources
    probability: float  # 0..1, of all sources together
    suggestions: tuple[Suggestion, ...]  # what each of them says, the likeliest first


def merged_suggestions(obj: Object, trust: Trust) -> tuple[MergedName, ...]:
    """Ranks suggested names of an object; none if a person or the upload named it.

    Sources are assumed to err independently, so agreement raises the probability. Per source the most probable word
    counts."""
    by_name: dict[str, dict[str, Suggestion]] = {}
    for suggestion in () if obj.source in _SETTLED else obj.suggestions:
        weighed = suggestion
        if suggestion.source:
            weighed = suggestion._replace(
                probability=min(suggestion.probability * trust.get(suggestion.source, 1.0), _MOST)
            )
        by_source = by_name.setdefault(label_key(suggestion.name), {})
        if suggestion.source not in by_source or weighed.probability > by_source[suggestion.source].probability:
            by_source[suggestion.source] = weighed
    merged = []
    for by_source in by_name.values():
        ordered = tuple(sorted(by_source.values(), key=lambda suggestion: -suggestion.probability))
        probability = agreed([suggestion.probability for suggestion in ordered])
        aliases = tuple(dict.fromkeys(alias for suggestion in ordered for alias in suggestion.aliases))
        merged.append(MergedName(ordered[0].name, aliases, probability, ordered))
    return tuple(sorted(merged, key=lambda name: -name.probability))


def agreed(probabilities: Sequence[float]) -> float:
    """Probability 0..1 that at least one of independent sources is right."""
    if len(probabilities) == 1:
        return probabilities[0]
    return min(1.0 - prod(1.0 - probability for probability in probabilities), _MOST)


def source_trust(said: Iterable[SaidName]) -> Trust:
    """Estimates each source's accuracy relative to its claims, from objects people named.

    Suggestions of an object are kept when a person names it. A source's right words are divided by the sum of its
    probabilities, both with the prior `_PRIOR`. The scene's own models are calibrated elsewhere and keep their word."""
    claimed: dict[str, float] = {}
    right: dict[str, int] = {}
    for said_name in said:
        claimed[said_name.source] = claimed.get(said_name.source, 0.0) + said_name.probability
        right[said_name.source] = right.get(said_name.source, 0) + said_name.right
    return {source: (right[source] + _PRIOR) / (claimed[source] + _PRIOR) for source in claimed}
