"""Names with words before them that a dictionary says nothing of: "wicker chair" where the label is "chair"."""

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
"""Words that make something else of what they stand before: a toy car is no car."""
_MATERIALS = frozenset(
    "wooden wood plastic rubber paper cardboard stone marble glass metal steel iron bronze brass copper porcelain "
    "ceramic china clay terracotta silk felt woolen knitted crocheted wax plaster concrete jade ivory chocolate "
    "marzipan gingerbread sugar balloon robot robotic mechanical electronic".split()
)
"""What nothing that lives is made of."""
_RAREST = 1.5
"""What the place of a label's sense may count (see `Meaning`) for a longer name to be a kind of it: a "piano key" is
one of a key's rare senses."""


@dataclass(frozen=True)
class Compounds:
    """Labels that a question names last, after words that no label answers for; of N labels."""

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
    """What the words before a label's name make of it.

    The lexicon decides where it has a longer end of the question than the label: "wall clock" is a kind of clock by it,
    "prairie dog" no kind of dog. Else the words are free, and only some of them make something else of what they stand
    before: those of `FEIGNING`, and materials before what lives.

    Args:
        words: what is asked for, singular.
        bases: by row of a label, how many of the last words are its name, or mean the same.
        meaning: of the question.
        labels: meanings of the labels.
        wider: by id, the senses that the question's first one is a kind of, itself among them.
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
    """Whether a label is an animal, a plant or a person, as far as its most frequent senses tell: a mug is a fool in
    one of them, and a plant a factory."""
    classes = [sense.lexical_class for sense, _ in label.ranked[:3]]
    person = classes[:1] == ["person"] and "artifact" not in classes
    return person or not {"animal", "plant", "tops"}.isdisjoint(classes[:2])
