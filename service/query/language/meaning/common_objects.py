"""Common objects with other names, kinds and uses, from `common_objects.txt`.

The lexicon's definitions rarely contain how people ask for an object. The list is this project's own, written without
looking at any list of questions."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.language.meaning.definition_words import NO_ROWS, UNKNOWN, LabelTexts, rows_by_key, stems
from fastsplat.service.query.language.meaning.embeddings import TextCache
from fastsplat.service.query.language.meaning.relevancy import F32, F64

FILE = Path(__file__).with_name("common_objects.txt")
"""Lines of name | other names | kinds | uses; the latter separated by semicolons."""

_MOST_TEXTS = 5
"""Most other names and uses embedded per label, because scenes open while somebody waits."""

COLUMNS = (
    *("known_as", "known_kind", "known_below", "kinds_shared", "uses_shared"),
    *("named", "use", "asked_known", "label_known"),
)
"""Columns of `KnownLabels.compare`."""


@dataclass(frozen=True)
class CommonObject:
    """One line of the list; names and kinds are keys of `label_key`."""

    names: tuple[str, ...]
    kinds: frozenset[str]
    uses: tuple[str, ...]


@cache
def all_common_objects() -> tuple[CommonObject, ...]:
    """Objects of the list, in its order."""
    rows = (line.split("|") for line in FILE.read_text("ascii").splitlines())
    return tuple(
        CommonObject((name.strip(), *_parts(aliases, ",")), frozenset(_parts(kinds, ",")), _parts(uses, ";"))
        for name, aliases, kinds, uses in rows
    )


@cache
def common_objects_digest() -> str:
    """Hex SHA-256 of the list."""
    return hashlib.sha256(FILE.read_bytes()).hexdigest()


@cache
def _by_name() -> dict[str, tuple[CommonObject, ...]]:
    found: dict[str, list[CommonObject]] = {}
    for obj in all_common_objects():
        for name in obj.names:
            found.setdefault(name, []).append(obj)
    return {name: tuple(objects) for name, objects in found.items()}


def _parts(text: str, separator: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(separator) if part.strip())


def common_objects(text: str) -> tuple[tuple[CommonObject, ...], bool]:
    """Objects with this name or its longest known end; True for the whole name."""
    words = label_key(text).split(" ")
    for start in range(len(words)):
        if objects := _by_name().get(" ".join(words[start:])):
            return objects, start == 0
    return (), False


def is_toy(name: str) -> bool:
    """True if the list knows this as a toy."""
    return any({"toy", "stuffed toy"} & obj.kinds for obj in common_objects(name)[0])


def are_other_objects(text: str, names: Sequence[str]) -> bool:
    """True if the list distinguishes a text from a label's names.

    Whole names only. Most of their kinds must belong to one alone: a sofa is no teddy bear, a chair no dining table
    (both are furniture). A fork and a spoon, of the same kinds, may stand in for each other, as may objects named by a
    use (coffee, cup)."""
    text_objects, whole = common_objects(text)
    found = [objects for objects, sure in map(common_objects, names) if sure]
    if not whole or not found:
        return False
    labeled = {obj for objects in found for obj in objects}
    label_names = {label_key(name) for name in names} | {name for obj in labeled for name in obj.names}
    wanted = {label_key(text)} | {name for obj in text_objects for name in obj.names}
    above = {kind for obj in text_objects for kind in obj.kinds}
    below = {kind for obj in labeled for kind in obj.kinds}
    shared, used = above & below, _use_words(labeled)
    served = {text} if shared else {text, *above}
    if label_names & (wanted | above) or below & wanted or any(stems(phrase) <= used for phrase in served):
        return False
    return 2 * len(shared) < len(above | below)


class KnownLabels:
    """Knowledge of the list about N labels (names of each, its own first); thread-safe."""

    def __init__(self, names: Sequence[Sequence[str]], cache: TextCache) -> None:
        found = [[common_objects(name) for name in label_names] for label_names in names]
        labels = [tuple(dict.fromkeys(obj for some, _ in matches for obj in some)) for matches in found]
        whole = np.array([any(whole for _, whole in matches) for matches in found], dtype=np.bool_)
        sure_labels = [objects if sure else () for objects, sure in zip(labels, whole, strict=True)]
        self._label_known = 0.5 * (np.array(list(map(bool, labels))) + whole.astype(np.float64))
        kinds = [frozenset[str]().union(*(obj.kinds for obj in objects)) for objects in labels]
        self._kinds = np.array(list(map(len, kinds)), dtype=np.float64)
        self._by_kind = rows_by_key(kinds)
        self._by_use_word = rows_by_key(list(map(_use_words, labels)))
        keys = [{label_key(name) for name in label_names} for label_names in names]
        self._by_name = rows_by_key(keys)
        self._by_object = rows_by_key(sure_labels)
        synonyms = [
            _first(name for obj in objects for name in obj.names if name not in label_keys)
            for objects, label_keys in zip(sure_labels, keys, strict=True)
        ]
        self._synonyms = LabelTexts(synonyms, cache)
        self._uses = LabelTexts([_first(use for obj in objects for use in obj.uses) for objects in labels], cache)

    @property
    def nbytes(self) -> int:
        """Bytes of the embeddings."""
        return self._synonyms.nbytes + self._uses.nbytes

    @property
    def keys(self) -> int:
        """Number of keys in the lookup tables."""
        return sum(len(rows) for rows in (self._by_name, self._by_kind, self._by_object, self._by_use_word))

    def compare(self, phrase: str, question: F32, similarity: F64) -> F64:
        """Features of a question for each label, float64 [N, C], by `COLUMNS`.

        known_as: 1 if both name one object. known_kind: 1 if the label is a kind of the question; known_below: vice
        versa. kinds_shared: IoU of their kinds. uses_shared: share of the question's use words that the label has.
        named, use: cosines of the question with the label's other names and uses. asked_known, label_known: 1 if
        listed, 0.5 if the last words are.

        Args:
            phrase: the question without question words and articles.
            question: float32 [E], its embedding.
            similarity: float64 [N], cosines with the labels.
        """
        objects, whole = common_objects(phrase)
        key = label_key(phrase)
        above = frozenset[str]().union(*(obj.kinds for obj in objects))
        columns = np.zeros((len(COLUMNS), len(self._kinds)))
        for obj in objects if whole else ():
            columns[0, self._by_object.get(obj, NO_ROWS)] = 1.0
        columns[0, self._by_name.get(key, NO_ROWS)] = 1.0
        columns[1, self._by_kind.get(key, NO_ROWS)] = 1.0
        for kind in above:
            columns[2, self._by_name.get(kind, NO_ROWS)] = float(whole)
            columns[3, self._by_kind.get(kind, NO_ROWS)] += 1.0
        columns[3] /= np.maximum(len(above) + self._kinds - columns[3], 1.0)
        used = _use_words(objects) if whole else frozenset[str]()
        for word in used:
            columns[4, self._by_use_word.get(word, NO_ROWS)] += 1.0 / len(used)
        columns[5] = np.maximum(self._synonyms.nearest(question, similarity), similarity)
        columns[6] = self._uses.nearest(question, UNKNOWN * similarity)
        columns[7] = 0.5 * (bool(objects) + whole)
        columns[8] = self._label_known
        return columns.T


def _use_words(objects: Iterable[CommonObject]) -> frozenset[str]:
    return frozenset[str]().union(*(stems(use) for obj in objects for use in obj.uses))


def _first(texts: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(texts))[:_MOST_TEXTS]
