"""The senses that a lexicon has for a text, and what their definitions say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fastsplat.service.perception.lexicon.wordnet import Lexicon, Sense

SOLID = frozenset({"artifact", "food", "animal", "plant", "body", "object", "substance", "person", "tops"})
"""Lexical classes of what can lie in a scene."""
_SENSES = 10
"""Senses of a text that are looked at, the most frequent first."""
_RARENESS = 0.5
"""What a place further down in the order of senses counts, in steps of kind: "stool" is a toilet in its third sense."""
_DEFINITIONS = 4
_WORDS, _CLAUSES = 26, 3
"""Of a label's definition, as far as it is embedded: what a thing is for often stands in its second clause."""
_ABOVE_STEPS = 2
_SHORTEST = 3
"""Letters of each part of a word that is written of two: shorter ones are parts of any word."""


@dataclass(frozen=True)
class Meaning:
    """The senses of a text.

    Attributes:
        ranked: senses of things that can lie in a scene, the most frequent first; each with what its place counts.
    """

    ranked: tuple[tuple[Sense, float], ...]
    whole: bool  # whether the lexicon has the whole text; else they are the senses of its head
    words: int = 0  # how many of its last words the lexicon has

    @property
    def senses(self) -> tuple[Sense, ...]:
        """Without what their places count."""
        return tuple(sense for sense, _ in self.ranked)


def label_meaning(names: Sequence[str], lexicon: Lexicon) -> Meaning:
    """The senses of a label and its aliases."""
    ranks: dict[Sense, float] = {}
    whole = False
    for name in names:
        own = ranked(lexicon.senses(name))
        whole = whole or bool(own)
        for sense, rare in own or head_meaning(name, lexicon).ranked:
            ranks[sense] = min(rare, ranks.get(sense, rare))
    return Meaning(tuple(ranks.items()), whole)


def head_meaning(phrase: str, lexicon: Lexicon) -> Meaning:
    """The senses of the longest end of a phrase that the lexicon has: "tower" of "light tower", "board" of
    "whiteboard"."""
    words = phrase.lower().replace("-", " ").split()
    if words and not lexicon.senses(words[-1]):
        words[-1:] = compound_parts(words[-1], lexicon)
    for start in range(len(words)):
        if senses := lexicon.senses(" ".join(words[start:])):
            return Meaning(ranked(senses), False, len(words) - start)
    return Meaning((), False)


def compound_parts(word: str, lexicon: Lexicon) -> tuple[str, ...]:
    """The two nouns that a word is written of in one, the last as long as it can be; the word alone if it is none."""
    for at in range(_SHORTEST, len(word) - _SHORTEST + 1):
        if lexicon.senses(word[:at]) and lexicon.senses(word[at:]):
            return word[:at], word[at:]
    return (word,)


def ranked(senses: Sequence[Sense]) -> tuple[tuple[Sense, float], ...]:
    """Those of things that can lie in a scene; the most frequent sense where there is none."""
    solid = [sense for sense in senses if sense.lexical_class in SOLID][:_SENSES] or senses[:1]
    return tuple((sense, _RARENESS * place) for place, sense in enumerate(solid))


def definitions(label: str, senses: Sequence[Sense], lexicon: Lexicon) -> list[str]:
    """Those of a label's senses, each after its name, and that of what it is a kind of in its first sense."""
    texts = [sense.definition for sense in senses[:_DEFINITIONS]]
    for above in (lexicon.sense(sense_id) for sense in senses[:1] for sense_id in sense.wider[:1]):
        texts.append(f"{above.words[0]}, {above.definition}")
    return [f"{label}: {_shortened(text, _WORDS, _CLAUSES)}" for text in texts]


def above_definitions(senses: Sequence[Sense], lexicon: Lexicon) -> list[str]:
    """The definitions of what a thing is a kind of in its first sense, up to two steps above it."""
    steps = {up: far for sense in senses[:1] for up, far in lexicon.wider(sense.id).items()}
    return [lexicon.sense(up).definition for up, far in steps.items() if 0 < far <= _ABOVE_STEPS]


def _shortened(definition: str, words: int, clauses: int) -> str:
    """The first clauses of a definition, and of these the first words."""
    return " ".join("; ".join(definition.split("; ")[:clauses]).split()[:words])
