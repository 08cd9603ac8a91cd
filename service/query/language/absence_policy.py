"""Decides between "not here" and "cannot say" if no name matches; table in docs/asking.md."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from fastsplat.service.common.dictionary import Dictionary, dictionary_of, label_key
from fastsplat.service.query.language.meaning.common_objects import common_objects
from fastsplat.service.query.language.meaning.word_senses import ranked as solid_senses
from fastsplat.service.query.language.sentences.enclosures import is_furniture
from fastsplat.service.query.language.words.judgement import Ranked
from fastsplat.service.query.language.words.name_matching import NameIndex
from fastsplat.service.query.objects.absence import RATHER, USUAL_M, unnamed_probability
from fastsplat.service.query.objects.color_names import NAMES as COLORS
from fastsplat.service.query.objects.color_names import UNMEASURED, basic_name
from fastsplat.service.query.objects.names.object_names import ObjectNames
from fastsplat.service.scene.artefact.scene import Object, SurfaceKind
from fastsplat_contract.messages.queries import Answer

if TYPE_CHECKING:
    from fastsplat.service.perception.lexicon.wordnet import Lexicon

FOUND = Path(__file__).parent / "meaning" / "found_names.json"
"""Objects that the default detector calls by their name, and all of it: `benchmarks.calibration.fit_names`."""
_PRIOR = 4.0
"""Weight of the share found of all names, in objects of a name."""
_LEAST_M, _MOST_M, _LEAST_LARGE_M = 0.02, 2.0, 0.35
"""Least and largest length of a candidate, meters; least length of a large one."""
_USUAL_LARGE_M, _SPREAD = 0.9, 1.0
"""Usual length of large objects, and the standard deviation of log lengths."""
_ROUND = frozenset({"animal", "body", "food", "person", "plant", "substance"})
"""Lexical classes of what is never a wall nor lies flat on one."""
_FAINT = 0.5
"""Weight added to the color share, so that objects of other colors still count."""
_NEAR = 0.05
"""Least probability of a name for its bearers to be offered."""
_ON, _OFF = 2.0, 0.3
"""Factors for objects whose kind of surface fits the question or does not."""
_NAMELESS, _MOST, _MOST_OFFERED = 0.3, 0.9, 8
"""Weights of nameless fitting objects and of suggestions against them; most objects offered."""
_LIVING = frozenset({"animal", "person"})
"""Lexical classes of which a model calls all kinds by one word."""
_UPRIGHT = frozenset({"art", "artwork", "opening", "part of a building", "wall decoration", "window covering"})
_LYING = frozenset({"bedding", "cloth", "floor covering", "soft furnishing", "table", "table linen", "textile"})
"""Kinds on walls, and kinds lying on something; see `common_objects`."""


@dataclass(frozen=True)
class Vocabulary:
    """Vocabulary of the models that looked at a scene."""

    names: Sequence[str]  # that were looked for
    lexicon: Lexicon | None  # knows kinds of objects; None: only names and the list of common objects count
    found_shares: Mapping[str, float]  # of objects called by a name, where it was not the default detector that looked

    @cached_property
    def _dictionary(self) -> Dictionary:
        return dictionary_of(self.names)

    @cached_property
    def _index(self) -> NameIndex:
        return NameIndex(self._dictionary)

    @cached_property
    def _by_sense(self) -> Mapping[int, str]:
        senses = {name: solid_senses(self.lexicon.senses(name))[:1] for name in self.names} if self.lexicon else {}
        return {sense.id: name for name, name_senses in senses.items() for sense, _ in name_senses}

    def word_for(self, text: str) -> str:
        """Finds the name that a model would use for such an object; "" for none.

        Its own name, a synonym, or, for animals and people, a hypernym."""
        exact = self._index.match(text).exact
        objects, whole = common_objects(text)
        ids = (*exact, *(self._dictionary.id_of(name) for obj in objects if whole for name in obj.names))
        known = [self._dictionary.entries[label_id - 1].label for label_id in ids if label_id]
        for sense, _ in solid_senses(self.lexicon.senses(text))[:1] if self.lexicon else ():
            above = self.lexicon.wider(sense.id) if self.lexicon and sense.lexical_class in _LIVING else (sense.id,)
            known += [self._by_sense.get(sense_id, "") for sense_id in above]
        return next(filter(None, known), "")

    def knows(self, text: str) -> bool:
        """True if a text as a whole is a name of something."""
        return common_objects(text)[1] or bool(self.lexicon and self.lexicon.senses(text))

    def found_share(self, word: str) -> float:
        """Share of objects of this name that the detector finds, 0..1."""
        names, usual = _found()
        found, objects = names.get(label_key(word), (0, 0))
        return self.found_shares.get(word, (found + usual * _PRIOR) / (objects + _PRIOR))

    def class_of(self, text: str) -> str:
        """Lexical class of a text's (or its end's) most frequent sense; "" if unknown."""
        words = text.split(" ")
        ends = (
            solid_senses(self.lexicon.senses(" ".join(words[at:]))) if self.lexicon else () for at in range(len(words))
        )
        return next((senses[0][0].lexical_class for senses in ends if senses), "")

    def surfaces_of(self, text: str) -> tuple[SurfaceKind, ...]:
        """Kinds of surfaces that such an object is, or lies flat on."""
        kinds = {kind for obj in common_objects(text)[0] for kind in obj.kinds}
        upright: tuple[SurfaceKind, ...] = ("wall", "surface") if kinds & _UPRIGHT else ()
        return (*upright, *(("horizontal surface", "floor", "surface") if kinds & _LYING else ()))


@cache
def _found() -> tuple[Mapping[str, tuple[int, int]], float]:
    stored = json.loads(FOUND.read_text())
    return stored["names"], stored["share"]


def with_absence_judged(
    ranked: Ranked,
    names: ObjectNames,
    vocabulary: Vocabulary,
    color_share: Callable[[int, str], float],
    presence_by_looks: Callable[[Ranked, Collection[int]], float | None],
) -> Ranked:
    """Decides between "not here" and "cannot say" if nothing bears the name.

    The prior for an object being here is 1/2. It can be a nameless object of fitting size; if there is none, it is not
    here. If the models could have said its name, they missed it with probability m = 1 - `found_share`, so it is not
    here with the probability 1 / (1 + m). Where a calibrated image-text model looked at all nameless objects that fit,
    it says how probable any known word is. Otherwise it cannot be said.

    Args:
        color_share: share 0..1 of an object clearly of a color.
        presence_by_looks: probability 0..1 that anything here looks so, of nameless objects; None: not measured.
    """
    answer, remarks = ranked.answer, ranked.remarks
    text = ranked.noun_phrase
    of_conditions = answer.phrase is not None and not remarks.head
    is_absent = (ranked.verdict == "absent" or remarks.other_object) and not of_conditions
    if remarks.no_question or not (is_absent or (_is_weak(ranked, names) and vocabulary.knows(text))):
        return ranked
    nameless = [obj for obj in names.present if (not obj.name or obj.guessed) and obj.id in names.lengths]
    fitting = [obj for obj in nameless if _may_be(obj, names.lengths[obj.id], text, vocabulary)]
    if all(obj.name for obj in fitting):
        return ranked
    figures = {match: match.relevancy if match.probability is None else match.probability for match in answer.matches}
    ordered = sorted(answer.matches, key=lambda match: -figures[match])
    matches = tuple(match._replace(relevant=False) for match in ordered)
    nothing, remarks = replace(answer, matches=matches, relation_subject=None), replace(remarks, other_object=False)
    word = vocabulary.word_for(text)
    seen = names.labels.id_of(word) if word else None
    presence: float | None = None
    if word and not (seen and names.labels.entries[seen - 1].views):
        missed = 1.0 - vocabulary.found_share(word)
        presence = missed / (1.0 + missed)
    elif vocabulary.class_of(text) or vocabulary.knows(text):
        presence = presence_by_looks(ranked, [obj.id for obj in fitting])
    if presence is not None and presence < RATHER:
        absent = replace(nothing, probability=None, object_ids=(), relation="absent")
        if answer.presence is not None:
            absent = replace(absent, presence=presence, probability=1.0 - presence)
        return replace(ranked, answer=absent, verdict="absent", standing=frozenset(), remarks=remarks)
    colors = (COLORS - UNMEASURED).intersection(re.findall(r"[a-z]+", answer.text.lower()))
    likely = unnamed_probability(names.searched)
    presence = None if answer.presence is None else 1.0 - (1.0 - answer.presence) * (1.0 - likely)
    shares = {obj.id: [color_share(obj.id, basic_name(color)) for color in colors] for obj in fitting}
    colored = {object_id: max(of_color, default=1.0) for object_id, of_color in shares.items()}
    may_be = _likeliest(text, answer, fitting, names, vocabulary, colored)
    offered = replace(nothing, presence=presence, probability=None, object_ids=may_be, relation="undecided")
    return replace(ranked, answer=offered, verdict="undecided", standing=frozenset(), remarks=remarks)


def _is_weak(ranked: Ranked, names: ObjectNames) -> bool:
    """True if the best answer is rather not what was asked for."""
    answer, remarks = ranked.answer, ranked.remarks
    plain = answer.phrase is None and not (remarks.by_shape or remarks.by_looks)
    if not plain or answer.relation != "related" or answer.probability is None or not answer.relevant_ids:
        return False
    return answer.probability < RATHER * names.table[answer.relevant_ids[0]].probability


def _likeliest(
    text: str,
    answer: Answer,
    fitting: Sequence[Object],
    names: ObjectNames,
    vocabulary: Vocabulary,
    colored: Mapping[int, float],
) -> tuple[int, ...]:
    """Ranks candidates by size, color, surface, suggestions and near names."""
    near = {match.label_id: match.probability or 0.0 for match in answer.matches}
    usual, lies_on = _USUAL_LARGE_M if is_furniture(text) else USUAL_M, vocabulary.surfaces_of(text)
    comes_near = [label_id for label_id in near if near[label_id] >= _NEAR]
    likely = {object_id: near[label_id] for label_id in comes_near for object_id in names.by_label.get(label_id, ())}
    for obj in fitting:
        off = math.log(names.lengths[obj.id] / usual) / _SPREAD
        suggestions = [
            (near.get(names.dictionary.id_of(suggestion.name) or 0, 0.0), suggestion.probability)
            for suggestion in obj.suggestions
        ]
        doubt = obj.probability if obj.name else sum(sure * (1.0 - alike) for alike, sure in suggestions)
        weight = math.exp(-off * off / 2) * obj.consensus * (1.0 - min(doubt, _MOST)) * (colored[obj.id] + _FAINT)
        kind = 1.0 if not obj.surface and not lies_on else _ON if obj.surface in lies_on else _OFF
        alike = max((alike for alike, _ in suggestions), default=near.get(names.labels.id_of(obj.name) or 0, 0.0))
        likely[obj.id] = _NAMELESS * weight * kind + alike
    return tuple(sorted(likely, key=lambda object_id: (-likely[object_id], object_id))[:_MOST_OFFERED])


def _may_be(obj: Object, length: float, text: str, vocabulary: Vocabulary) -> bool:
    """True if an object of this length in meters may be what is asked for."""
    if is_furniture(text):
        return length >= _LEAST_LARGE_M
    flat = bool(obj.surface) and vocabulary.class_of(text) in _ROUND
    return _LEAST_M <= length <= _MOST_M and not flat
