"""Evidence of use: words of questions in definitions of labels, and labels' nearest texts."""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.language.meaning.embeddings import TextCache
from fastsplat.service.query.language.meaning.relevancy import F32, F64

if TYPE_CHECKING:
    from fastsplat.service.perception.lexicon.wordnet import Lexicon, Verb


NO_ROWS: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
_Key = TypeVar("_Key", bound=Hashable)
_WORD = re.compile(r"[a-z]+")
_EMPTY = frozenset(
    "a an the my your our it its into in on up from with some for at of to out off through down before who what when "
    "where which behind under away and or as by is are be that this than i me you something anything thing someone "
    "somebody somewhere place use used using not no more most other any one have has having can do does get put make "
    "usually often especially etc".split()
)
_ENDINGS = ("ings", "ing", "ers", "er", "ies", "ied", "ed", "es", "s", "e", "y")
_SHORTEST = 3
_VERB_SENSES, _VERB_STEPS = 6, 2


def stems(text: str) -> frozenset[str]:
    """Stems of the content words of a text, without most English endings."""
    return frozenset(_stem(word) for word in _WORD.findall(text.lower()) if len(word) > 1 and word not in _EMPTY)


@lru_cache(16_384)
def _stem(word: str) -> str:
    for ending in _ENDINGS:
        if word.endswith(ending) and len(word) - len(ending) >= _SHORTEST:
            word = word.removesuffix(ending)
            break
    return word[:-1] if len(word) > _SHORTEST and word[-1] == word[-2] else word


class DefinitionWords:
    """Words of the definitions (and names, for verbs) of N labels; thread-safe."""

    def __init__(self, definitions: Sequence[Iterable[str]], names: Sequence[Iterable[str]]) -> None:
        self._count = len(definitions)
        self._rows = _by_stem(definitions)
        self._named = _by_stem(names)

    def shared(self, question: str) -> F64:
        """Share of the question's words in each label's definitions, [N]; common words weigh less."""
        question_stems = stems(question)
        values = np.zeros(self._count)
        for stem in question_stems:
            rows = self._rows.get(stem, NO_ROWS)
            values[rows] += 1.0 - len(rows) / (self._count + 1)
        return values / max(len(question_stems), 1)

    def done(self, verbs: Mapping[str, int]) -> F64:
        """Verbs (with hypernym steps) in each label's definitions, float64 [N], 0..1."""
        values = np.zeros(self._count)
        for verb, steps in verbs.items():
            for stem in stems(verb):
                rows = self._rows.get(stem, NO_ROWS)
                value = (1.0 - len(rows) / (self._count + 1)) / (1.0 + steps)
                values[rows] = np.maximum(values[rows], value)
        return values

    def mentioned(self, definitions: Iterable[str]) -> F64:
        """Labels named in definitions of verbs ("with a broom"), float64 [N], 0 or 1."""
        values = np.zeros(self._count)
        for stem in frozenset[str]().union(*map(stems, definitions)):
            values[self._named.get(stem, NO_ROWS)] = 1.0
        return values


def verbs_of(words: Sequence[str], lexicon: Lexicon) -> tuple[dict[str, int], list[str]]:
    """Verbs that words may mean, with steps above the word, and the words' definitions."""
    found: dict[str, int] = {}
    definitions: list[str] = []
    for word in words:
        level: tuple[Verb, ...] = lexicon.verbs(word)[:_VERB_SENSES]
        definitions += [verb.definition for verb in level]
        for steps in range(_VERB_STEPS + 1):
            for verb in level:
                for name in verb.words:
                    found.setdefault(name, steps)
            level = tuple(lexicon.verb(above) for verb in level for above in verb.wider)
    return found, definitions


def rows_by_key(keys: Sequence[Iterable[_Key]]) -> dict[_Key, NDArray[np.intp]]:
    """Rows that have each key, in order."""
    found: dict[_Key, list[int]] = {}
    for row, row_keys in enumerate(keys):
        for key in row_keys:
            found.setdefault(key, []).append(row)
    return {key: np.array(rows, dtype=np.intp) for key, rows in found.items()}


def _by_stem(texts: Sequence[Iterable[str]]) -> dict[str, NDArray[np.intp]]:
    return rows_by_key([frozenset[str]().union(*map(stems, row_texts)) for row_texts in texts])


UNKNOWN = 0.6
"""Share of the cosine with a label's name that replaces unknown cosines."""
_NOTHING = "thing"
"""Placeholder for labels without a text; masked."""


class LabelTexts:
    """Texts of each of N labels, embedded without templates; thread-safe."""

    def __init__(self, texts: Sequence[Sequence[str]], cache: TextCache) -> None:
        flat = [text for row_texts in texts for text in row_texts or (_NOTHING,)]
        self._embedded = cache.embed(flat, ("{}",)) if flat else np.zeros((0, 0), dtype=np.float32)
        self._starts = np.cumsum([0, *(len(row_texts) or 1 for row_texts in texts)])[:-1].astype(np.intp)
        self._known: NDArray[np.bool_] = np.array([bool(row_texts) for row_texts in texts], dtype=np.bool_)

    @property
    def nbytes(self) -> int:
        """Bytes of the embeddings."""
        return self._embedded.nbytes

    def nearest(self, question: F32, otherwise: F64) -> F64:
        """Cosine of a question [E] with each label's nearest text, float64 [N], or `otherwise`."""
        if not len(self._known):
            return otherwise
        return np.where(self._known, np.maximum.reduceat(self._embedded @ question, self._starts), otherwise)
