"""Lexical features of a question and a dictionary's labels, for a model."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary, label_key
from fastsplat.service.query.language.meaning.common_objects import COLUMNS, KnownLabels
from fastsplat.service.query.language.meaning.definition_words import UNKNOWN, DefinitionWords, LabelTexts, verbs_of
from fastsplat.service.query.language.meaning.embeddings import TextCaches
from fastsplat.service.query.language.meaning.relevancy import F64
from fastsplat.service.query.language.meaning.word_senses import (
    SOLID,
    Meaning,
    above_definitions,
    compound_parts,
    definitions,
    head_meaning,
    label_meaning,
    ranked,
)
from fastsplat.service.query.language.words.name_matching import NameMatch
from fastsplat.service.query.language.words.noun_phrases import parse_noun_phrase, split_modifiers

if TYPE_CHECKING:
    from fastsplat.service.perception.lexicon.wordnet import Lexicon
    from fastsplat.service.query.language.meaning.word_senses import Meaning


Rows = NDArray[np.intp]
_Key = TypeVar("_Key", bound=Hashable)

_CLASSES = ("artifact", "food", "animal", "plant", "person", "act")
_SPECIFIC_DEPTH = 5
"""Least depth of an informative common hypernym; above are entity, object, whole, artifact."""
_DETERMINERS = frozenset(
    "a an the my it into in on up from with some for at of to out off through down before who what when where which "
    "behind under away and".split()
)
_PER_KEY = 512
"""Estimated bytes of a lookup key (sense or word): two short arrays and their slot."""
_WORD_SENSES = 3
"""Senses of a label whose definitions' words count."""

BASE = (
    *("similarity", "definition"),
    *("same", "wider", "narrower", "kinship", "part", "whole"),
    *("head_same", "head_wider", "head_narrower", "head_kinship"),
    *("class_shared", "in_lexicon", "has_sense", "label_has_sense", "label_in_lexicon"),
    *("last_word", "modifier", "word_shared", "grammar_head", "grammar_kind"),
    *("verb_phrase", "verb_first", "words"),
    *(f"is_{name}" for name in _CLASSES),
    "is_other",
    *("compound", "feigned", "other_name", "shared_words", "done", "done_with"),
    *COLUMNS,
)
"""Columns of `Comparison`, see `LabelMeanings.compare`."""

_Mask = NDArray[np.bool_]

_FEIGNING = frozenset(
    "toy toys fake artificial imitation mock pretend sham replica dummy model miniature counterfeit faux stuffed plush "
    "cartoon virtual imaginary doll doll's dolls dolls' dollhouse barbie lego origami".split()
)
"""Words that make something else of the noun: a toy car is no car."""
_MATERIALS = frozenset(
    "wooden wood plastic rubber paper cardboard stone marble glass metal steel iron bronze brass copper porcelain "
    "ceramic china clay terracotta silk felt woolen knitted crocheted wax plaster concrete jade ivory chocolate "
    "marzipan gingerbread sugar balloon robot robotic mechanical electronic".split()
)
"""Materials that no living object is made of."""
_RAREST = 1.5
"""Largest rareness of a label's sense with kinds; "piano key" is a rare one."""


@dataclass(frozen=True)
class Relations:
    """Lexical relations of one question to N labels, float64 [N], 0..1.

    Attributes:
        wider: 1 / steps from a sense of the label up to one of the question ("fruit" of banana); here and below steps
            include the rareness of both senses.
    """

    same: F64  # 1 where they share the first sense of both, less where it is a rarer one
    wider: F64
    narrower: F64  # the other way: "armchair" of chair
    kinship: F64  # Wu and Palmer's similarity (1994, section 3) by the deepest specific sense that both are kinds of
    part: F64  # 1 where the question is a part or the substance of the label
    whole: F64  # 1 where the label is one of the question


@dataclass(frozen=True)
class Comparison:
    """Comparison of one question with N labels by lexicon and encoder."""

    columns: F64  # float64 [N, F], by `BASE`
    meaning: Meaning  # the senses of the question
    relations: Relations  # those of the labels to it
    compounds: Compounds  # the labels that it names after other words


class LabelMeanings:
    """Senses, embedded definitions and hypernyms of a dictionary's labels; thread-safe.

    Raises:
        ModelUnavailableError: the lexicon's files are inconsistent, or the encoder returns something other than
            embeddings.
    """

    def __init__(self, dictionary: Dictionary, lexicon: Lexicon, caches: TextCaches) -> None:
        self._lexicon, self._cache = lexicon, caches.texts
        self._names = names = _names(dictionary)
        meanings = [label_meaning(label_names, lexicon) for label_names in names]
        self._count = len(names)
        self._known = np.array([bool(meaning.senses) for meaning in meanings], dtype=np.bool_)
        self._whole = np.array([meaning.whole for meaning in meanings], dtype=np.float64)
        self._classes = np.array(
            [[float(any(s.lexical_class == name for s in m.senses)) for name in sorted(SOLID)] for m in meanings]
        ).reshape(self._count, len(SOLID))
        self._meanings = meanings
        self._definitions = LabelTexts(
            [definitions(label_names[0], m.senses, lexicon) for label_names, m in zip(names, meanings, strict=True)],
            caches.definitions,
        )
        self._known_objects = KnownLabels(names, caches.definitions)
        self._definition_words = DefinitionWords(
            [
                [*(s.definition for s in m.senses[:_WORD_SENSES]), *above_definitions(m.senses, lexicon)]
                for m in meanings
            ],
            [
                [*label_names, *(word for s in m.senses[:1] for word in s.words)]
                for label_names, m in zip(names, meanings, strict=True)
            ],
        )
        self._by_sense = _inverted((row, s.id, rare) for row, m in enumerate(meanings) for s, rare in m.ranked)
        above = [
            (row, up, steps, rare)
            for row, m in enumerate(meanings)
            for s, rare in m.ranked
            for up, steps in lexicon.wider(s.id).items()
        ]
        self._lines = _inverted((row, up, steps + rare) for row, up, steps, rare in above)
        self._above = _inverted((row, up, steps + rare) for row, up, steps, rare in above if steps)
        self._parts = _inverted(
            (row, part, rare) for row, m in enumerate(meanings) for s, rare in m.ranked for part in s.parts
        )
        words = [label_key(label_names[0]).split(" ") for label_names in names]
        self._last = _inverted((row, label_words[-1], 1.0) for row, label_words in enumerate(words))
        self._words = _inverted((row, word, 1.0) for row, label_words in enumerate(words) for word in label_words)

    @property
    def nbytes(self) -> int:
        """Estimated bytes in memory."""
        keys = sum(len(rows) for rows in (self._by_sense, self._lines, self._above, self._parts))
        keys += len(self._last) + len(self._words) + self._known_objects.keys
        texts = self._definitions.nbytes + self._known_objects.nbytes
        return texts + _PER_KEY * keys

    def is_of(self, dictionary: Dictionary) -> bool:
        """True if these are a dictionary's labels and aliases, in order."""
        return self._names == _names(dictionary)

    def is_word(self, word: str) -> bool:
        """True if the lexicon has the word, its singular, its two parts, or a verb."""
        known = any(self._lexicon.senses(form) for form in (word, label_key(word))) or self._lexicon.is_verb(word)
        return known or len(compound_parts(word, self._lexicon)) > 1

    def meaning(self, text: str) -> Meaning:
        """Senses of a question: of the whole phrase, or of its head."""
        phrase = parse_noun_phrase(text)
        if whole := ranked(self._lexicon.senses(phrase.text)):
            return Meaning(whole, True, len(phrase.text.split()))
        if self._is_verb_phrase(phrase.text) or len(phrase.heads) != 1:
            return Meaning((), False)
        return head_meaning(phrase.heads[0], self._lexicon)

    def compare(self, text: str, match: NameMatch, similarity: F64) -> Comparison:
        """Computes the columns `BASE` and the relations behind them.

        These are cosines with the label and its definitions; `Relations` of the question, or of its head if the lexicon
        lacks it; classes of both; shared words; the form of the question; and the columns of `KnownLabels.compare`."""
        phrase = parse_noun_phrase(text).text
        meaning = self.meaning(text)
        count, columns = self._count, np.zeros((len(BASE), self._count))
        relations = self.relations(meaning)
        named_last = self._compounds(text, match, meaning, relations)
        if not count:
            return Comparison(columns.T, meaning, relations, named_last)
        question = self._cache.embed([phrase])[0]
        place = {name: number for number, name in enumerate(BASE)}
        columns[place["similarity"]] = similarity
        columns[place["definition"]] = self._definitions.nearest(question, UNKNOWN * similarity)
        first = place["same"] if meaning.whole else place["head_same"]
        columns[first : first + 4] = relations.same, relations.wider, relations.narrower, relations.kinship
        if meaning.whole:
            columns[place["part"]], columns[place["whole"]] = relations.part, relations.whole
        classes = {sense.lexical_class for sense in meaning.senses}
        shared = self._classes @ np.array([float(name in classes) for name in sorted(SOLID)])
        columns[place["class_shared"]] = np.where(self._known & bool(classes), shared > 0, 0.5)
        columns[place["in_lexicon"]] = meaning.whole
        columns[place["has_sense"]] = bool(meaning.senses)
        columns[place["label_has_sense"]] = self._known
        columns[place["label_in_lexicon"]] = self._whole
        self._compare_words(phrase, match, columns, place)
        words = phrase.lower().split()
        columns[place["verb_phrase"]] = self._is_verb_phrase(phrase)
        columns[place["verb_first"]] = len(words) > 1 and self._lexicon.is_verb(words[0])
        columns[place["words"]] = min(len(words), 6) / 6
        for name in _CLASSES:
            columns[place[f"is_{name}"]] = name in classes
        columns[place["is_other"]] = bool(classes) and not classes & set(_CLASSES)
        columns[place["compound"]] = named_last.same_kind
        columns[place["feigned"]] = named_last.feigned
        columns[place["other_name"]] = named_last.other_name
        leading = words[:1] if self._is_verb_phrase(" ".join(words)) else []
        candidates = [*leading, *(word for before, word in pairwise(words) if before == "to")]
        verbs, glosses_of_verbs = verbs_of(candidates, self._lexicon)
        columns[place["shared_words"]] = self._definition_words.shared(phrase)
        columns[place["done"]] = self._definition_words.done(verbs)
        columns[place["done_with"]] = self._definition_words.mentioned(glosses_of_verbs)
        columns[place[COLUMNS[0]] :] = self._known_objects.compare(phrase, question, similarity).T
        return Comparison(columns.T, meaning, relations, named_last)

    def relations(self, meaning: Meaning) -> Relations:
        """Lexical relations between a question's meaning and the labels."""
        same, wider, narrower, kinship, part, whole = np.zeros((6, self._count))
        for sense, rare in meaning.ranked:
            _raise(same, self._by_sense.get(sense.id), partial(_nearness, 1.0 + rare))
            _raise(wider, self._above.get(sense.id), partial(_nearness, rare))
            _raise(part, self._parts.get(sense.id), partial(_nearness, 1.0 + rare))
            for part_id in sense.parts:
                _raise(whole, self._by_sense.get(part_id), partial(_nearness, 1.0 + rare))
            for above, steps in self._lexicon.wider(sense.id).items():
                if steps:
                    _raise(narrower, self._by_sense.get(above), partial(_nearness, steps + rare))
                depth = self._depth(above)
                if depth >= _SPECIFIC_DEPTH:
                    _raise(kinship, self._lines.get(above), partial(_kinship, steps + rare, depth))
        return Relations(same, wider, narrower, kinship, part, whole)

    def _depth(self, sense_id: int) -> int:
        return max(self._lexicon.wider(sense_id).values())

    def _is_verb_phrase(self, phrase: str) -> bool:
        """True if the question is an action: "sweep the floor"."""
        words = phrase.lower().split()
        return len(words) > 1 and not _DETERMINERS.isdisjoint(words[1:]) and self._lexicon.is_verb(words[0])

    def _compounds(self, text: str, match: NameMatch, meaning: Meaning, relations: Relations) -> Compounds:
        """Labels that the question ends in, by name or synonym, after other words."""
        phrase = parse_noun_phrase(text)
        _, head = split_modifiers(phrase.heads[0]) if len(phrase.heads) == 1 else (None, "")
        words = head.split(" ")
        bases: dict[int, int] = {}
        if not self._is_verb_phrase(phrase.text) and _DETERMINERS.isdisjoint(words):
            if not meaning.whole and 0 < meaning.words < len(words):
                same = np.flatnonzero((relations.same == 1.0) & (self._whole > 0))
                bases = dict.fromkeys(same.tolist(), meaning.words)
            bases |= {label_id - 1: count for label_id, count in match.bases.items()}
        first = meaning.ranked[0][0] if meaning.ranked else None
        wider = {} if first is None else self._lexicon.wider(first.id)
        return _compounds_of(words, bases, meaning, self._meanings, wider)

    def _compare_words(self, phrase: str, match: NameMatch, columns: F64, place: Mapping[str, int]) -> None:
        words = label_key(phrase).split(" ")
        last, modifier, shared = np.zeros((3, self._count))
        _raise(last, self._last.get(words[-1]), np.ones_like)
        for word in words[:-1]:
            _raise(modifier, self._last.get(word), np.ones_like)
        for word in words:
            _raise(shared, self._words.get(word), np.ones_like)
        columns[place["last_word"]] = last
        columns[place["modifier"]] = modifier
        columns[place["word_shared"]] = (shared > 0) & (last == 0) & (modifier == 0)
        columns[place["grammar_head"], np.array(match.heads, dtype=np.intp) - 1] = 1.0
        columns[place["grammar_kind"], np.array(match.hyponyms, dtype=np.intp) - 1] = 1.0


def _names(dictionary: Dictionary) -> list[tuple[str, ...]]:
    return [(entry.label, *entry.aliases) for entry in dictionary.entries]


def _raise(values: F64, rows: tuple[Rows, F64] | None, of_steps: Callable[[F64], F64]) -> None:
    """Raises values at rows to a function of the steps there."""
    if rows is not None:
        values[rows[0]] = np.maximum(values[rows[0]], of_steps(rows[1]))


def _nearness(more: float, steps: F64) -> F64:
    return np.asarray(1.0 / (steps + more))


def _kinship(up: float, depth: int, down: F64) -> F64:
    """Wu and Palmer's similarity of senses `up` and `down` steps below a common one."""
    return np.asarray(2.0 * depth / (up + down + 2.0 * depth))


def _inverted(triples: Iterable[tuple[int, _Key, float]]) -> dict[_Key, tuple[Rows, F64]]:
    """Rows that have each key, with their smallest value."""
    by_key: dict[_Key, dict[int, float]] = {}
    for row, key, value in triples:
        values = by_key.setdefault(key, {})
        values[row] = min(value, values.get(row, value))
    return {
        key: (np.fromiter(values, dtype=np.intp), np.fromiter(values.values(), dtype=np.float64))
        for key, values in by_key.items()
    }


@dataclass(frozen=True)
class Compounds:
    """Labels that end the question, after words without a label; of N labels."""

    same_kind: _Mask  # bool [N], those that these words leave what they are: "chair" of "wicker chair"
    feigned: _Mask  # bool [N], those of which they make something else: "car" of "toy car"
    other_name: _Mask  # bool [N], those that end the name of something else: "table" of "periodic table"
    before: Mapping[int, str]  # by row of a kept one, the words before it: "wicker"


def _compounds_of(
    words: Sequence[str],
    bases: Mapping[int, int],
    meaning: Meaning,
    labels: Sequence[Meaning],
    wider: Mapping[int, int],
) -> Compounds:
    """Classifies the words before a label's name.

    The lexicon decides if it has a longer end of the question than the label: "wall clock" is a kind of clock, "prairie
    dog" no kind of dog. Otherwise only some words make something else of the noun: those of `_FEIGNING`, and materials
    before what lives. `bases` has the number of last words that are a label's name, `wider` the hypernyms of the
    question's first sense."""
    same_kind, feigned, other_kind = np.zeros((3, len(labels)), dtype=np.bool_)
    before = {}
    for row, count in bases.items():
        free = words[: len(words) - count]
        label = labels[row]
        if meaning.words > count:
            kinds = any(sense.id in wider for sense, rare in label.ranked if rare <= _RAREST)
            same_kind[row], other_kind[row] = kinds, not kinds
        else:
            feigned[row] = not _FEIGNING.isdisjoint(free) or (_lives(label) and not _MATERIALS.isdisjoint(free))
            same_kind[row] = not feigned[row]
        if same_kind[row]:
            before[row] = " ".join(free)
    return Compounds(same_kind, feigned, other_kind, before)


def _lives(label: Meaning) -> bool:
    """True if a label's most frequent senses are animal, plant or person.

    Rare senses mislead: a mug may be a fool, a plant a factory."""
    classes = [sense.lexical_class for sense, _ in label.ranked[:3]]
    person = classes[:1] == ["person"] and "artifact" not in classes
    return person or not {"animal", "plant", "tops"}.isdisjoint(classes[:2])
