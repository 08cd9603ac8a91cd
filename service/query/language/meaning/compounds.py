"""Compounds of a label with unknown words before it: "wicker chair" for "chair"."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from fastsplat.service.query.language.meaning.word_senses import Meaning

Mask = NDArray[np.bool_]

FEIGNING = frozenset(
    "toy toys fake artificial imitation mock pretend sham replica dummy model miniature counterfeit faux stuffed plush "
    "cartoon virtual imaginary doll doll's dolls dolls' dollhouse barbie lego origami".split()
)
"""Words that make something else of the noun: a toy car is no car."""
_MATERIALS = frozenset(
    "wooden wood plastic rubber paper cardboard stone marble glass metal steel iron bronze brass copper porcelain "
    "ceramic china clay terracotta silk felt woolen knitted crocheted wax plaster concrete jade ivory chocolate "
    "marzipan gingerbread sugar balloon robot robotic mechanical electronic".split()
)
"""Materials that no living thing is made of."""
_RAREST = 1.5
"""Largest rareness of a label's sense with kinds; "piano key" is a rare one."""


@dataclass(frozen=True)
class Compounds:
    """Labels that end the question, after words without a label; of N labels."""

    kept: Mask  # bool [N], those that these words leave what they are: "chair" of "wicker chair"
    feigned: Mask  # bool [N], those of which they make something else: "car" of "toy car"
    other: Mask  # bool [N], those that end the name of something else: "table" of "periodic table"
    before: Mapping[int, str]  # by row of a kept one, the words before it: "wicker"


def compounds(
    words: Sequence[str],
    bases: Mapping[int, int],
    meaning: Meaning,
    labels: Sequence[Meaning],
    wider: Mapping[int, int],
) -> Compounds:
    """Classifies the words before a label's name.

    The lexicon decides if it has a longer end of the question than the label: "wall clock" is a kind of clock, "prairie
    dog" no kind of dog. Otherwise only some words make something else of the noun: those of `FEIGNING`, and materials
    before what lives.

    Args:
        words: the question, singular.
        bases: by row of a label, the number of last words that are its name or a synonym.
        meaning: of the question.
        labels: meanings of the labels.
        wider: hypernyms of the question's first sense, by id, including itself.
    """
    kept, feigned, other = np.zeros((3, len(labels)), dtype=np.bool_)
    before = {}
    for row, count in bases.items():
        free = words[: len(words) - count]
        own = labels[row]
        if meaning.words > count:
            kinds = any(sense.id in wider for sense, rare in own.ranked if rare <= _RAREST)
            kept[row], other[row] = kinds, not kinds
        else:
            feigned[row] = not FEIGNING.isdisjoint(free) or (_lives(own) and not _MATERIALS.isdisjoint(free))
            kept[row] = not feigned[row]
        if kept[row]:
            before[row] = " ".join(free)
    return Compounds(kept, feigned, other, before)


def _lives(label: Meaning) -> bool:
    """True if a label's most frequent senses are animal, plant or person.

    Rare senses mislead: a mug may be a fool, a plant a factory."""
    classes = [sense.lexical_class for sense, _ in label.ranked[:3]]
    person = classes[:1] == ["person"] and "artifact" not in classes
    return person or not {"animal", "plant", "tops"}.isdisjoint(classes[:2])
