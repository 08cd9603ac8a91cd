"""Names that people gave in other scenes, suggested for the things that look like what they named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.scene.suggestions import SaidName
from fastsplat.service.scene.types import Thing

_RIVAL = 0.5
_SCORES, _PROBABILITIES = (0.86, 1.05, 1.2), (0.8, 0.85, 0.95)
"""From the first score on a name is suggested; between them the probability is interpolated. Chosen where 95 % of the
suggestions on the demo's sample, on the same things elsewhere and on photos of something else were right; what came of
it on things that nothing was chosen on is in docs/naming.md."""


@dataclass(frozen=True)
class KnownThing:
    """A thing that a person named: its scene, its descriptor as in `Thing.appearance`, what others had said, and the
    tags on it with their probabilities."""

    scene_id: str
    name: str
    appearance: bytes = field(repr=False)
    said: tuple[SaidName, ...] = ()
    tags: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class NameFromScene:
    """A name that a thing may have, because it looks like what a person named so in another scene, or bears its tag:
    then `source` is not ""."""

    name: str
    probability: float
    scene_id: str
    source: str = ""


def names_by_looks(things: Sequence[Thing], known: Sequence[KnownThing]) -> Mapping[int, NameFromScene]:
    """The name that each thing's looks suggest, by its id; of most things none.

    A known thing suggests its name for the one thing here that is most like it, and a thing takes the suggestion of the
    known thing that it is most like. The score is the cosine of the two descriptors, plus half of how far the likest
    known thing of another name is behind. Things that a person named keep their likeness to themselves: they get no
    suggestion, and nothing else gets theirs.

    Args:
        things: all of the scene, named ones, too.
        known: of other scenes; a descriptor of another size than the things' is none.
    """
    here = [thing for thing in things if thing.appearance]
    size = len(here[0].appearance) if here else 0
    there = [thing for thing in known if len(thing.appearance) == size]
    if not here or not there:
        return {}
    likeness = _rows([thing.appearance for thing in here]) @ _rows([thing.appearance for thing in there]).T
    keys = np.array([label_key(thing.name) for thing in there])
    names = {}
    for row, thing in zip(likeness, here, strict=True):
        best = int(row.argmax())
        if thing.source == "person" or likeness[:, best].max() > row[best]:
            continue
        rival = max(0.0, float(row[keys != keys[best]].max(initial=0.0)))
        score = float(row[best]) + _RIVAL * (float(row[best]) - rival)
        if score >= _SCORES[0]:
            probability = float(np.interp(score, _SCORES, _PROBABILITIES))
            names[thing.id] = NameFromScene(there[best].name, probability, there[best].scene_id)
    return names


def _rows(descriptors: Sequence[bytes]) -> NDArray[np.float32]:
    return np.stack([np.frombuffer(descriptor, np.float16) for descriptor in descriptors]).astype(np.float32)
