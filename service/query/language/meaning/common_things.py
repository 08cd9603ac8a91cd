"""What people call common things, what they count them among and what they do with them: `common_things.txt`.

The lexicon defines words; how people ask for a thing without its name, or by another one, stands in few of its
definitions. The list is of this project's own words, and was written without a look at any list of questions.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.language.meaning.definition_words import NO_ROWS, rows_by_key, stems
from fastsplat.service.query.language.meaning.embeddings import TextCache
from fastsplat.service.query.language.meaning.label_texts import UNKNOWN, LabelTexts
from fastsplat.service.query.language.meaning.relevancy import F32, F64

FILE = Path(__file__).with_name("common_things.txt")
"""A line for each thing: name | other names | kinds | uses; names and kinds, divided by commas, as `label_key` has
them, uses divided by semicolons."""

_MOST_TEXTS = 5
"""Other names of a label that are embedded, and uses: scenes are opened while somebody waits."""

COLUMNS = (
    *("known_as", "known_kind", "known_below", "kinds_shared", "uses_shared"),
    *("named", "use", "asked_known", "label_known"),
)
"""What `KnownLabels.compare` says of each label."""


@dataclass(frozen=True)
class CommonThing:
    """One line of the list. Names and kinds are keys, see `label_key`."""

    names: tuple[str, ...]
    kinds: frozenset[str]
    uses: tuple[str, ...]


@cache
def _by_name() -> dict[str, tuple[CommonThing, ...]]:
    """The things of the list that bear each name."""
    found: dict[str, list[CommonThing]] = {}
    for line in FILE.read_text("ascii").splitlines():
        name, others, kinds, uses = line.split("|")
        thing = CommonThing((name.strip(), *_parts(others, ",")), frozenset(_parts(kinds, ",")), _parts(uses, ";"))
        for each in thing.names:
            found.setdefault(each, []).append(thing)
    return {name: tuple(things) for name, things in found.items()}


def _parts(text: str, separator: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(separator) if part.strip())


def common_things(text: str) -> tuple[tuple[CommonThing, ...], bool]:
    """The things that bear this name, or else the longest end of it; and whether it is the whole name."""
    words = label_key(text).split(" ")
    for start in range(len(words)):
        if things := _by_name().get(" ".join(words[start:])):
            return things, start == 0
    return (), False


def is_toy(name: str) -> bool:
    """Tells whether what is called so is known to be a toy."""
    return any({"toy", "stuffed toy"} & thing.kinds for thing in common_things(name)[0])


def are_other_things(text: str, names: Sequence[str]) -> bool:
    """Whether the list tells a text from what bears these names, by the whole names of both: it has most kinds of one
    alone. A sofa is no teddy bear, and a chair no dining table, though both are furniture. A fork and a spoon, of the
    same kinds, may stand in for each other; coffee is what a cup is for, and tea a hot drink, which a coffee machine
    brews.

    Args:
        text: a name, without question words and articles.
        names: of one label.
    """
    asked, whole = common_things(text)
    found = [things for things, sure in map(common_things, names) if sure]
    if not whole or not found:
        return False
    labeled = {thing for things in found for thing in things}
    own = {label_key(name) for name in names} | {name for thing in labeled for name in thing.names}
    wanted = {label_key(text)} | {name for thing in asked for name in thing.names}
    above = {kind for thing in asked for kind in thing.kinds}
    below = {kind for thing in labeled for kind in thing.kinds}
    shared, used = above & below, _use_words(labeled)
    served = {text} if shared else {text, *above}
    if own & (wanted | above) or below & wanted or any(stems(each) <= used for each in served):
        return False
    return 2 * len(shared) < len(above | below)


class KnownLabels:
    """What the list knows of N labels. Threads may share it.

    Args:
        names: of each label, its own first.
        cache: embeds other names and uses.

    Raises:
        ModelUnavailableError: the encoder answers with something else than embeddings.
    """

    def __init__(self, names: Sequence[Sequence[str]], cache: TextCache) -> None:
        found = [[common_things(name) for name in each] for each in names]
        things = [tuple(dict.fromkeys(thing for some, _ in each for thing in some)) for each in found]
        whole = np.array([any(whole for _, whole in each) for each in found], dtype=np.bool_)
        self._label_known = 0.5 * (np.array([bool(each) for each in things]) + whole.astype(np.float64))
        kinds = [frozenset[str]().union(*(thing.kinds for thing in each)) for each in things]
        self._kinds = np.array([len(each) for each in kinds], dtype=np.float64)
        self._by_kind = rows_by_key(kinds)
        self._by_use_word = rows_by_key([_use_words(each) for each in things])
        keys = [{label_key(name) for name in each} for each in names]
        self._by_name = rows_by_key(keys)
        self._by_thing = rows_by_key([each if sure else () for each, sure in zip(things, whole, strict=True)])
        others = [
            _first(other for thing in each for other in thing.names if other not in own) if sure else ()
            for each, sure, own in zip(things, whole, keys, strict=True)
        ]
        self._others = LabelTexts(others, cache)
        self._uses = LabelTexts([_first(use for thing in each for use in thing.uses) for each in things], cache)

    @property
    def nbytes(self) -> int:
        """What the embeddings weigh."""
        return self._others.nbytes + self._uses.nbytes

    @property
    def keys(self) -> int:
        """By how many names, kinds, things and words labels are looked up."""
        return sum(len(rows) for rows in (self._by_name, self._by_kind, self._by_thing, self._by_use_word))

    def compare(self, phrase: str, question: F32, similarity: F64) -> F64:
        """float64 [N, C], by `COLUMNS`.

        known_as: 1 where the list calls one thing by the question and the label. known_kind: 1 where it counts the
        label among what is asked for. known_below: the other way. kinds_shared: the share of the kinds of both that
        are the same. uses_shared: the share of the words of the question's uses that stand in the label's. named, use:
        cosines of the question with the label's other names and uses. asked_known, label_known: 1 where the list has
        the question and the label, 0.5 where their last words.

        Args:
            phrase: the question without question words and articles.
            question: float32 [E], its embedding.
            similarity: float64 [N], cosines with the labels.
        """
        asked, whole = common_things(phrase)
        key = label_key(phrase)
        above = frozenset[str]().union(*(thing.kinds for thing in asked))
        columns = np.zeros((len(COLUMNS), len(self._kinds)))
        for thing in asked if whole else ():
            columns[0, self._by_thing.get(thing, NO_ROWS)] = 1.0
        columns[0, self._by_name.get(key, NO_ROWS)] = 1.0
        columns[1, self._by_kind.get(key, NO_ROWS)] = 1.0
        for kind in above:
            columns[2, self._by_name.get(kind, NO_ROWS)] = float(whole)
            columns[3, self._by_kind.get(kind, NO_ROWS)] += 1.0
        columns[3] /= np.maximum(len(above) + self._kinds - columns[3], 1.0)
        used = _use_words(asked) if whole else frozenset[str]()
        for word in used:
            columns[4, self._by_use_word.get(word, NO_ROWS)] += 1.0 / len(used)
        columns[5] = np.maximum(self._others.nearest(question, similarity), similarity)
        columns[6] = self._uses.nearest(question, UNKNOWN * similarity)
        columns[7] = 0.5 * (bool(asked) + whole)
        columns[8] = self._label_known
        return columns.T


def _use_words(things: Iterable[CommonThing]) -> frozenset[str]:
    return frozenset[str]().union(*(stems(use) for thing in things for use in thing.uses))


def _first(texts: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(texts))[:_MOST_TEXTS]
