"""The one policy of absence: what is said of a thing when nothing here is called so; its table is in docs/asking.md."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from fastsplat.service.common.dictionary import dictionary_of, label_key
from fastsplat.service.query.language.common_things import common_things
from fastsplat.service.query.language.enclosures import is_large
from fastsplat.service.query.language.judgement import Ranked
from fastsplat.service.query.language.name_matching import NameIndex
from fastsplat.service.query.language.noun_phrases import noun_phrase
from fastsplat.service.query.language.word_senses import ranked as solid_senses
from fastsplat.service.query.things.absence import USUAL_M, unnamed_probability
from fastsplat.service.query.things.thing_names import ThingNames
from fastsplat.service.scene.types import Thing

if TYPE_CHECKING:
    from fastsplat.service.perception.lexicon.wordnet import Lexicon

_COUNTED: Mapping[str, tuple[int, int]] = {
    **{"apple": (8, 14), "banana": (4, 5), "book": (102, 106), "bottle": (16, 16), "bowl": (14, 14)},
    **{"cell phone": (3, 3), "chair": (12, 12), "clock": (6, 7), "couch": (3, 3), "cup": (28, 30), "fork": (1, 3)},
    **{"dining table": (14, 19), "donut": (8, 8), "keyboard": (1, 1), "knife": (3, 6), "laptop": (2, 2)},
    **{"mouse": (3, 3), "orange": (15, 17), "potted plant": (4, 7), "scissors": (6, 12), "spoon": (0, 3)},
    **{"sports ball": (1, 2), "teddy bear": (4, 5), "tv": (1, 1), "vase": (3, 4)},
}
"""Of the things of each name in the sets of `name_calibration.json`: how many the default detector called so most of
all names, and how many there are."""
_OTHERS, _PRIOR = 0.85, 4.0
"""The share of all of these but the books that it called so, and as how many things of each name that counts."""
_LEAST_M, _MOST_M, _LEAST_LARGE_M = 0.02, 2.0, 0.35
"""Between which lengths a thing may be what is asked for; from which on, if that is large."""
_USUAL_LARGE_M, _SPREAD = 0.9, 1.0
"""The usual length of what is large, and the standard deviation of the logarithms of lengths."""
_ROUND = frozenset({"animal", "body", "food", "person", "plant", "substance"})
"""Lexical classes of what is never a wall, nor lies flat on one."""
_MOST_OFFERED = 6


@dataclass(frozen=True)
class Vocabulary:
    """The words that the models which looked at a scene could say.

    Attributes:
        names: that were looked for.
        lexicon: knows kinds of things; None: only names and the list of common things count.
    """

    names: Sequence[str]
    lexicon: Lexicon | None

    @cached_property
    def _index(self) -> NameIndex:
        return NameIndex(dictionary_of(self.names))

    @cached_property
    def _by_key(self) -> Mapping[str, str]:
        return {label_key(name): name for name in self.names}

    @cached_property
    def _by_sense(self) -> Mapping[int, str]:
        senses = {name: solid_senses(self.lexicon.senses(name))[:1] for name in self.names} if self.lexicon else {}
        return {sense.id: name for name, own in senses.items() for sense, _ in own}

    def word_for(self, text: str) -> str:
        """The name that a model which found such a thing would have called it by: its own, another word for it, or one
        that it is a kind of; "" for none."""
        exact = self._index.match(text).exact
        if exact:
            return list(self._by_key.values())[exact[0] - 1]
        things, whole = common_things(text)
        known = [word for thing in things if whole for word in (*thing.names, *sorted(thing.kinds))]
        above = [
            self._by_sense.get(up, "")
            for sense, _ in (solid_senses(self.lexicon.senses(text))[:1] if self.lexicon else ())
            for up in self.lexicon.wider(sense.id)
        ]
        return next(filter(None, (*(self._by_key.get(word, "") for word in known), *above)), "")

    def class_of(self, text: str) -> str:
        """The lexical class of the most frequent sense of a text, or of what it ends in; "" where that is not known."""
        words = text.split(" ")
        ends = (
            solid_senses(self.lexicon.senses(" ".join(words[at:]))) if self.lexicon else () for at in range(len(words))
        )
        return next((senses[0][0].lexical_class for senses in ends if senses), "")


def found_share(word: str) -> float:
    """0..1: how often the default detector finds a thing of a name where there is one, or suggests that name for it."""
    found, things = _COUNTED.get(label_key(word), (0, 0))
    return (found + _OTHERS * _PRIOR) / (things + _PRIOR)


def with_absence_judged(
    ranked: Ranked, names: ThingNames, vocabulary: Vocabulary, color_share: Callable[[int, str], float]
) -> Ranked:
    """The same, where nothing is what was asked for, with what that says of the whole scene.

    Before anything is looked at, a thing is as likely here as not. Things without a name that are as large as it may be
    are what it can be. If there are none, it is not here. If the models could have said its name, it was missed with
    the probability 1 - `found_share`, and it is not here with the rest. Else nobody can say.

    Args:
        ranked: what is decided of a text.
        names: of the scene's things.
        vocabulary: of the models that looked at the scene.
        color_share: of the thing with an id, 0..1, how much of it is clearly of a color.
    """
    answer, remarks = ranked.answer, ranked.remarks
    of_conditions = answer.phrase is not None and not remarks.head
    if not (ranked.verdict == "absent" or remarks.other) or remarks.no_question or of_conditions:
        return ranked
    asked = remarks.head or noun_phrase(answer.text)
    fitting = [
        thing
        for thing in names.present
        if not thing.name and thing.id in names.lengths and _may_be(thing, names.lengths[thing.id], asked, vocabulary)
    ]
    if not fitting:
        return ranked
    word = vocabulary.word_for(asked)
    if word:
        missed = 1.0 - found_share(word)
        likely = missed / (1.0 + missed)
    else:
        likely = unnamed_probability(names.searched)
    presence = None if answer.presence is None else 1.0 - (1.0 - answer.presence) * (1.0 - likely)
    if word:
        probability = None if presence is None or answer.probability is None else 1.0 - presence
        return replace(ranked, answer=replace(answer, presence=presence, probability=probability))
    by_label = {match.label_id: match.probability or 0.0 for match in answer.matches}

    def likely_it(thing: Thing) -> float:
        """How likely it is this thing, beside others."""
        off = math.log(names.lengths[thing.id] / (_USUAL_LARGE_M if is_large(asked) else USUAL_M)) / _SPREAD
        label_ids = [names.dictionary.id_of(each.name) or 0 for each in thing.suggestions]
        return math.exp(-off * off / 2) * thing.consensus + max(
            (by_label.get(each, 0.0) for each in label_ids), default=0
        )

    likeliest = sorted(fitting, key=likely_it, reverse=True)[:_MOST_OFFERED]
    matches = tuple(match._replace(relevant=False) for match in answer.matches)
    offered = replace(
        answer,
        presence=presence,
        probability=None,
        matches=matches,
        things=tuple(thing.id for thing in likeliest),
        relation="undecided",
        relation_subject=None,
    )
    return replace(
        ranked, answer=offered, verdict="undecided", standing=frozenset(), remarks=replace(remarks, other=False)
    )


def _may_be(thing: Thing, length: float, asked: str, vocabulary: Vocabulary) -> bool:
    """Whether a thing without a name, so many meters long, may be what is asked for."""
    if is_large(asked):
        return length >= _LEAST_LARGE_M
    flat = bool(thing.surface) and vocabulary.class_of(asked) in _ROUND
    return _LEAST_M <= length <= _MOST_M and not flat
