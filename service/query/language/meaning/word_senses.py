"""Senses of a text in a lexicon, and their definitions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fastsplat.service.perception.lexicon.wordnet import Lexicon, Sense

SOLID = frozenset({"artifact", "food", "animal", "plant", "body", "object", "substance", "person", "tops"})
"""Lexical classes of physical objects."""
_SENSES = 10
"""Senses considered, most frequent first."""
_RARENESS = 0.5
"""Steps of kind per rank in the order of senses ("stool", third: a toilet)."""
_DEFINITIONS = 4
_WORDS, _CLAUSES = 26, 3
"""Words and clauses of an embedded definition: the second clause often has the purpose."""
_ABOVE_STEPS = 2
_SHORTEST = 3
"""Least letters of each part of a compound word."""


@dataclass(frozen=True)
class Meaning:
    """The senses of a text."""

    ranked: tuple[tuple[Sense, float], ...]  # senses of physical objects, most frequent first, with rareness in steps
    whole: bool  # whether the lexicon has the whole text; else they are the senses of its head
    words: int = 0  # how many of its last words the lexicon has

    @property
    def senses(self) -> tuple[Sense, ...]:
        """The senses without their rareness."""
        return tuple(sense for sense, _ in self.ranked)


def label_meaning(names: Sequence[str], lexicon: Lexicon) -> Meaning:
    """Senses of a label and its aliases."""
    ranks: dict[Sense, float] = {}
    whole = False
    for name in names:
        senses = ranked(lexicon.senses(name))
        whole = whole or bool(senses)
        for sense, rare in senses or head_meaning(name, lexicon).ranked:
            ranks[sense] = min(rare, ranks.get(sense, rare))
    return Meaning(tuple(ranks.items()), whole)


def head_meaning(phrase: str, lexicon: Lexicon) -> Meaning:
    """Senses of the longest known end of a phrase: "tower" of "light tower"."""
    words = phrase.lower().replace("-", " ").split()
    if words and not lexicon.senses(words[-1]):
        words[-1:] = compound_parts(words[-1], lexicon)
    for start in range(len(words)):
        if senses := lexicon.senses(" ".join(words[start:])):
            return Meaning(ranked(senses), False, len(words) - start)
    return Meaning((), False)


def compound_parts(word: str, lexicon: Lexicon) -> tuple[str, ...]:
    """Splits a compound word into two known nouns, the first as short as possible."""
    for at in range(_SHORTEST, len(word) - _SHORTEST + 1):
        if lexicon.senses(word[:at]) and lexicon.senses(word[at:]):
            return word[:at], word[at:]
    return (word,)


def ranked(senses: Sequence[Sense]) -> tuple[tuple[Sense, float], ...]:
    """Senses of physical objects with their rareness, else the most frequent sense."""
    solid = [sense for sense in senses if sense.lexical_class in SOLID][:_SENSES] or senses[:1]
    return tuple((sense, _RARENESS * place) for place, sense in enumerate(solid))


def definitions(label: str, senses: Sequence[Sense], lexicon: Lexicon) -> list[str]:
    """Definitions of a label's senses, and of its first sense's hypernym."""
    texts = [sense.definition for sense in senses[:_DEFINITIONS]]
    for above in (lexicon.sense(sense_id) for sense in senses[:1] for sense_id in sense.wider[:1]):
        texts.append(f"{above.words[0]}, {above.definition}")
    return [f"{label}: {_shortened(text, _WORDS, _CLAUSES)}" for text in texts]


def above_definitions(senses: Sequence[Sense], lexicon: Lexicon) -> list[str]:
    """Definitions of the first sense's hypernyms, up to two steps above."""
    steps = {up: far for sense in senses[:1] for up, far in lexicon.wider(sense.id).items()}
    return [lexicon.sense(up).definition for up, far in steps.items() if 0 < far <= _ABOVE_STEPS]


def _shortened(definition: str, words: int, clauses: int) -> str:
    """First clauses of a definition, limited in words."""
    return " ".join("; ".join(definition.split("; ")[:clauses]).split()[:words])
