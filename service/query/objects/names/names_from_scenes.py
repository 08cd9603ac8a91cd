"""Suggests names that people gave in other scenes, to similar objects or by tags."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.objects.names.look_alikes import Sizes
from fastsplat.service.query.objects.names.merged_suggestions import TAG_SOURCE
from fastsplat.service.scene.artefact.reads import tags_of
from fastsplat.service.scene.artefact.scene import Object, Objects
from fastsplat.service.scene.artefact.suggestions import SaidName

_PER_SIZE = 0.5
"""Likeness lost per unit of log size difference, up to `_MOST_APART`."""
_MOST_APART = 1.5
_UNKNOWN_APART = 0.25
"""Size difference of a pair with an unknown size."""
_KNOWN_NAMES, _NONE_OF_THESE = (1, 40), (0.6, 0.2)
"""Assumed likeness of an unnamed rival by the number of known names, among many of which the right one is likelier."""
_PER_LEAD = 4.0
"""Score lost per unit of likeness by which another object here is more like the known one."""
_PER_RIVAL = 3.0
"""Greatest probability per unit of lead over the best rival of another name, above the half that equals have."""
_SCORES, _PROBABILITIES = (0.75, 0.85, 0.95, 1.2), (0.6, 0.78, 0.88, 0.95)
"""Thresholds for suggestions: scores and their probabilities, interpolated in between.

Chosen on the true objects of the six validation rooms of `benchmarks.rooms`, each compared with 1, 3, 8, 16 and
all names of the five others; results on held-out objects are in docs/naming.md."""
_SMALLEST = 1e-4
"""Least size in meters, for flat objects."""
_NO_SIZE = np.full(3, np.nan)
_NO_SIZE_BYTES = _NO_SIZE.astype(np.float16).tobytes()
_SIZE_BYTES = len(_NO_SIZE_BYTES)


@dataclass(frozen=True)
class KnownObject:
    """An object that a person named, with its descriptor, earlier suggestions and tags."""

    scene_id: str
    name: str
    appearance: bytes = field(repr=False)
    said: tuple[SaidName, ...] = ()
    tags: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class NameFromScene:
    """A name suggested from another scene, by looks or, with a `source`, by tag."""

    name: str
    probability: float
    scene_id: str
    source: str = ""


def described(objects: Objects | None, sizes: Sizes) -> Mapping[int, bytes]:
    """Descriptors for other scenes: `Object.appearance`, then the size as float16 [3] if known."""
    ends = {object_id: size.astype(np.float16).tobytes() for object_id, size in sizes.items()}
    table = () if objects is None else objects.table
    return {obj.id: obj.appearance + ends.get(obj.id, b"") for obj in table if obj.appearance}


def names_by_looks(
    objects: Sequence[Object], known: Sequence[KnownObject], sizes: Sizes
) -> Mapping[int, NameFromScene]:
    """Suggests a name by looks for each object, by id; for most none.

    Likeness is the cosine of the descriptors less the size difference; the score adds the lead over the best rival of
    another name, or over an assumed unnamed one, and loses where another object here is more like the known one.
    Objects that a person named get no suggestion but count there, so pass them, too. Descriptors of another length are
    ignored."""
    here = [obj for obj in objects if obj.appearance]
    length = len(here[0].appearance) if here else 0
    there = [obj for obj in known if len(obj.appearance) - length in (0, _SIZE_BYTES)]
    if not here or not there:
        return {}
    likeness = _rows([obj.appearance for obj in here]) @ _rows([obj.appearance[:length] for obj in there]).T
    ours = np.array([sizes.get(obj.id, _NO_SIZE) for obj in here])
    theirs = np.array([np.frombuffer(obj.appearance[length:] or _NO_SIZE_BYTES, np.float16) for obj in there])
    likeness = likeness - _PER_SIZE * _apart(ours, theirs.astype(np.float64))
    keys = np.array([label_key(obj.name) for obj in there])
    unnamed = float(np.interp(len(set(keys)), _KNOWN_NAMES, _NONE_OF_THESE))
    names = {}
    for row, obj in zip(likeness, here, strict=True):
        best = int(row.argmax())
        if obj.source == "person":
            continue
        rival = row[keys != keys[best]].max(initial=0.0)
        score = 2 * row[best] - max(unnamed, rival) - _PER_LEAD * (likeness[:, best].max() - row[best])
        if score >= _SCORES[0]:
            equal = 0.5 + _PER_RIVAL * (row[best] - rival)
            probability = float(min(np.interp(score, _SCORES, _PROBABILITIES), equal))
            names[obj.id] = NameFromScene(there[best].name, probability, there[best].scene_id)
    return names


def _apart(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean absolute log size difference of sizes [A, 3] and [B, 3], float64 [A, B]."""
    logs = [np.log(np.maximum(sizes, _SMALLEST)) for sizes in (ours, theirs)]
    apart = np.minimum(np.abs(logs[0][:, None] - logs[1][None]).mean(axis=2), _MOST_APART)
    return np.where(np.isfinite(apart), apart, _UNKNOWN_APART)


def _rows(descriptors: Sequence[bytes]) -> NDArray[np.float32]:
    return np.stack([np.frombuffer(descriptor, np.float16) for descriptor in descriptors]).astype(np.float32)


_STAYS = 0.97
"""Probability that a tag is still on the same object. Set, not measured."""


def names_by_tags(objects: Sequence[Object], known: Sequence[KnownObject]) -> Mapping[int, NameFromScene]:
    """Suggests names by the tags on each object, by object id.

    A tag on several objects here, or with several names in one scene, is ignored. If scenes differ, the latest name
    counts: somebody moved the tag. Objects that a person named get no suggestion."""
    borne = {obj.id: tags_of(obj.reads) for obj in objects}
    count = Counter(tag for tags in borne.values() for tag in tags)
    names: dict[int, NameFromScene] = {}
    for obj in objects:
        for tag, here in borne[obj.id].items() if obj.source != "person" else ():
            bearing = [bearer for bearer in known if tag in dict(bearer.tags)]
            there = [bearer for bearer in bearing if bearer.scene_id == bearing[0].scene_id]
            if count[tag] > 1 or len({label_key(bearer.name) for bearer in there}) != 1:
                continue
            probability = _STAYS * here * dict(there[0].tags)[tag]
            if obj.id not in names or probability > names[obj.id].probability:
                names[obj.id] = NameFromScene(there[0].name, probability, there[0].scene_id, TAG_SOURCE)
    return names
