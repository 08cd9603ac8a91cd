"""Names that people gave in other scenes, suggested for the things that look like what they named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.scene.artefact.scene import Thing, Things
from fastsplat.service.scene.artefact.suggestions import SaidName

if TYPE_CHECKING:
    from fastsplat.service.query.things.names.look_alikes import Sizes

_PER_SIZE = 0.5
"""By how much a pair is less alike for each unit that the logarithms of its sizes differ by, up to `_MOST_APART`."""
_MOST_APART = 1.5
_UNKNOWN_APART = 0.25
"""What a pair counts for of which a size is not known."""
_NONE_OF_THESE = 0.6
"""How much like a thing is what nobody named: where few things are known, of few names, that is the rival."""
_SCORES, _PROBABILITIES = (0.7, 0.88, 0.95, 1.2), (0.4, 0.55, 0.88, 0.95)
"""From the first score on a name is suggested; between them the probability is interpolated. Chosen by the things that
are found in the six validation rooms of `benchmarks.rooms`, each compared with one, five and all of the names of the
five others; what came of it on things that nothing was chosen on is in docs/naming.md."""
_SMALLEST = 1e-4
"""Meters; of a flat thing."""
_NO_SIZE = np.full(3, np.nan)
_NO_SIZE_BYTES = _NO_SIZE.astype(np.float16).tobytes()
_SIZE_BYTES = len(_NO_SIZE_BYTES)


@dataclass(frozen=True)
class KnownThing:
    """A thing that a person named: its scene, its descriptor as in `described`, what others had said, and the tags on
    it with their probabilities."""

    scene_id: str
    name: str
    appearance: bytes = field(repr=False)
    said: tuple[SaidName, ...] = ()
    tags: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class NameFromScene:
    """A name that a thing may have, because it looks like what a person named so in another scene; `source` is not ""
    where it bears its tag."""

    name: str
    probability: float
    scene_id: str
    source: str = ""


def described(things: Things | None, sizes: Sizes) -> Mapping[int, bytes]:
    """What the things that have a descriptor are known by in other scenes, by id: that (`Thing.appearance`), then the
    size as float16 [3], if it is known."""
    ends = {thing_id: size.astype(np.float16).tobytes() for thing_id, size in sizes.items()}
    table = () if things is None else things.table
    return {thing.id: thing.appearance + ends.get(thing.id, b"") for thing in table if thing.appearance}


def names_by_looks(things: Sequence[Thing], known: Sequence[KnownThing], sizes: Sizes) -> Mapping[int, NameFromScene]:
    """The name that each thing's looks suggest, by its id; of most things none.

    A known thing suggests its name for the one thing here that is most like it, and a thing takes the suggestion of the
    known thing that it is most like. How alike two things are is the cosine of their descriptors, less what their sizes
    differ by; the score is that, plus how far the likest known thing of another name is behind, or what nobody named.
    Things that a person named keep their likeness to themselves: they get no suggestion, and nothing else gets theirs.

    Args:
        things: all of the scene, named ones, too.
        known: of other scenes; a descriptor of another length than the things' is none.
        sizes: of the scene's things; where one is not known, looks alone count.
    """
    here = [thing for thing in things if thing.appearance]
    length = len(here[0].appearance) if here else 0
    there = [thing for thing in known if len(thing.appearance) - length in (0, _SIZE_BYTES)]
    if not here or not there:
        return {}
    likeness = _rows([thing.appearance for thing in here]) @ _rows([thing.appearance[:length] for thing in there]).T
    ours = np.array([sizes.get(thing.id, _NO_SIZE) for thing in here])
    theirs = np.array([np.frombuffer(thing.appearance[length:] or _NO_SIZE_BYTES, np.float16) for thing in there])
    likeness = likeness - _PER_SIZE * _apart(ours, theirs.astype(np.float64))
    keys = np.array([label_key(thing.name) for thing in there])
    names = {}
    for row, thing in zip(likeness, here, strict=True):
        best = int(row.argmax())
        if thing.source == "person" or likeness[:, best].max() > row[best]:
            continue
        rival = max(_NONE_OF_THESE, float(row[keys != keys[best]].max(initial=0.0)))
        score = 2 * float(row[best]) - rival
        if score >= _SCORES[0]:
            probability = float(np.interp(score, _SCORES, _PROBABILITIES))
            names[thing.id] = NameFromScene(there[best].name, probability, there[best].scene_id)
    return names


def _apart(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> NDArray[np.float64]:
    """float64 [A, B]: the mean distance of the logarithms of sizes [A, 3] and [B, 3]."""
    logs = [np.log(np.maximum(sizes, _SMALLEST)) for sizes in (ours, theirs)]
    apart = np.minimum(np.abs(logs[0][:, None] - logs[1][None]).mean(axis=2), _MOST_APART)
    return np.where(np.isfinite(apart), apart, _UNKNOWN_APART)


def _rows(descriptors: Sequence[bytes]) -> NDArray[np.float32]:
    return np.stack([np.frombuffer(descriptor, np.float16) for descriptor in descriptors]).astype(np.float32)
