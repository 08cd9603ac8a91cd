"""What several sources suggest for one thing as one list of names, each source weighed by what people confirmed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import prod

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.scene.artefact.scene import NameSource, Thing
from fastsplat.service.scene.artefact.suggestions import SaidName, Suggestion

OWN_SOURCE = "detector"
"""What the scene's own models and likenesses are called as a source."""
TAG_SOURCE = "tag"
"""What the printed tags on things are called as a source."""
_SETTLED: tuple[NameSource, ...] = ("given", "person")
"""Beside a name by one of these no suggestion counts."""
_PRIOR = 4.0
"""Confirmations that a source's own word counts for. Set, not measured."""
_MOST = 0.99
"""However often sources were right, a name is suggested and not known."""

Trust = Mapping[str, float]
"""By what the probabilities of each source are multiplied; 1 for sources of which nothing is known."""


@dataclass(frozen=True)
class MergedName:
    """A name that is suggested for one thing."""

    name: str  # as its likeliest source writes it
    aliases: tuple[str, ...]  # other words for it, of all sources
    probability: float  # 0..1, of all sources together
    told: tuple[Suggestion, ...]  # what each of them says, the likeliest first


def merged_suggestions(thing: Thing, trust: Trust) -> tuple[MergedName, ...]:
    """The names that are suggested for a thing, the most probable first; none beside one that a person gave.

    Sources are taken to err independently: a name is wrong only if all that suggest it are, so two that agree count
    more than either. Of one source the most probable word counts.
    """
    by_name: dict[str, dict[str, Suggestion]] = {}
    for each in () if thing.source in _SETTLED else thing.suggestions:
        weighed = each
        if each.source:
            weighed = each._replace(probability=min(each.probability * trust.get(each.source, 1.0), _MOST))
        told = by_name.setdefault(label_key(each.name), {})
        if each.source not in told or weighed.probability > told[each.source].probability:
            told[each.source] = weighed
    merged = []
    for told in by_name.values():
        ordered = tuple(sorted(told.values(), key=lambda one: -one.probability))
        probability = agreed([one.probability for one in ordered])
        aliases = tuple(dict.fromkeys(alias for one in ordered for alias in one.aliases))
        merged.append(MergedName(ordered[0].name, aliases, probability, ordered))
    return tuple(sorted(merged, key=lambda one: -one.probability))


def agreed(probabilities: Sequence[float]) -> float:
    """0..1: that a name is right which sources of these probabilities, at least one, suggest independently."""
    if len(probabilities) == 1:
        return probabilities[0]
    return min(1.0 - prod(1.0 - each for each in probabilities), _MOST)


def source_trust(said: Iterable[SaidName]) -> Trust:
    """How far each source is right more or less often than it says, by the things that people named.

    A thing that a person named keeps what was suggested for it. Over these a source's right words, as many as it
    claimed before anything was confirmed (`_PRIOR`), are divided by the sum of its probabilities. The scene's own
    models are measured elsewhere, and keep their word.

    Args:
        said: of things that people named, see `Thing.said`.
    """
    claimed: dict[str, float] = {}
    right: dict[str, int] = {}
    for each in said:
        claimed[each.source] = claimed.get(each.source, 0.0) + each.probability
        right[each.source] = right.get(each.source, 0) + each.right
    return {source: (right[source] + _PRIOR) / (claimed[source] + _PRIOR) for source in claimed}
