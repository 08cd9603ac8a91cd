"""What a question says beside the name of a thing: colors, sizes, relations to other things, an order, a number."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from fastsplat_contract.phrase_messages import Asks

RelationKind = Literal[
    "on", "in", "under", "above", "next_to", "near", "left_of", "right_of", "in_front_of", "behind", "between"
]
SizeKind = Literal["size", "height", "length", "width"]
OrderKind = Literal["size", "height", "length", "width", "elevation", "distance", "from_left"]

SEEN_FROM: frozenset[RelationKind] = frozenset({"left_of", "right_of", "in_front_of", "behind"})
"""Relations that depend on where the asker stands."""


@dataclass(frozen=True)
class ColorWord:
    """A color: "light blue", or one that is denied: "not red".

    Attributes:
        name: of the color, as in `color_names`.
        shade: "", "light" or "dark".
        negated: whether the phrase denies it.
    """

    name: str
    shade: str = ""
    negated: bool = False

    @property
    def text(self) -> str:
        """In words."""
        return " ".join(word for word in ("not" if self.negated else "", self.shade, self.name) if word)


@dataclass(frozen=True)
class SizeWord:
    """A size in comparison with others of the kind: "big" in "the big mug".

    Attributes:
        word: as asked.
        by: what is compared.
        more: whether it asks for the larger ones.
    """

    word: str
    by: SizeKind
    more: bool


@dataclass(frozen=True)
class Relation:
    """Where a thing is: "on the table", "between the lamp and the mug".

    Attributes:
        kind: of the relation.
        anchors: what it is related to; none: the asker.
        negated: whether the phrase denies it.
        text: as asked.
    """

    kind: RelationKind
    anchors: tuple[Phrase, ...]
    negated: bool
    text: str


@dataclass(frozen=True)
class Possession:
    """What a thing has: a part or another thing with it ("with a handle"), or a content ("of water").

    Attributes:
        kind: "with" or "of".
        phrase: what it has.
        negated: whether the phrase denies it: "without a handle".
        text: as asked.
    """

    kind: Literal["with", "of"]
    phrase: Phrase
    negated: bool
    text: str


@dataclass(frozen=True)
class Says:
    """What is written on a thing: "that says oat milk", "by Woolf".

    Attributes:
        words: that are written there.
        negated: whether the phrase denies it.
        text: as asked.
    """

    words: str
    negated: bool
    text: str


@dataclass(frozen=True)
class Rank:
    """One of several in an order: "the second largest", "second from the left", "nearest to the lamp".

    Attributes:
        by: what they are ordered by.
        descending: whether the most is first; from the right, for "from_left".
        number: which one, 1 is the first.
        anchors: of "distance", from what; none: from the asker.
        text: as asked.
    """

    by: OrderKind
    descending: bool
    number: int
    anchors: tuple[Phrase, ...] = ()
    text: str = ""


Condition = Relation | Possession | Says


@dataclass(frozen=True)
class Phrase:
    """A noun phrase.

    Attributes:
        head: the noun group, without the modifiers below: "coffee machine"; "" for anything at all.
        group: the noun group with its colors and sizes, as asked: "big red mug", which may be a name.
        definite: whether it speaks of one that is known: "the lamp"; "lamps", "a lamp" and "lamp" are not.
        colors, sizes, conditions: what is said of it, in order.
        rank: which one of them; None for all.
    """

    head: str
    group: str
    definite: bool = False
    colors: tuple[ColorWord, ...] = ()
    sizes: tuple[SizeWord, ...] = ()
    conditions: tuple[Condition, ...] = ()
    rank: Rank | None = None

    @property
    def is_plain(self) -> bool:
        """Whether it is a name or a description, and nothing beside it."""
        return not (self.colors or self.sizes or self.conditions or self.rank)

    @property
    def said(self) -> tuple[str, ...]:
        """What is said of the head, in words."""
        words = [color.text for color in self.colors] + [size.word for size in self.sizes]
        words += [condition.text for condition in self.conditions]
        return tuple(words if self.rank is None else [*words, self.rank.text])


@dataclass(frozen=True)
class ParsedQuestion:
    """A question that says more than a name.

    Attributes:
        asks: whether it asks which things, or how many.
        readings: what it may mean, at least one reading: "the mug on the table next to the lamp" has two, by what is
            next to the lamp. All have the same head.
        not_understood: the words that were left over; "" without.
    """

    asks: Asks
    readings: tuple[Phrase, ...]
    not_understood: str

    @property
    def of_writing(self) -> bool:
        """Whether it may be about what is written on the things that it asks for."""
        return any(isinstance(each, Says) for reading in self.readings for each in reading.conditions)


@dataclass(frozen=True)
class Named:
    """The things that a noun group names.

    Attributes:
        ids: of things and parts.
        by_name: whether it is their name, or an alias; False for what was found by meaning.
        whole: whether the name has the colors and sizes of the group in it: "red mug" is a name here.
        suggested: whether the name is merely suggested for them.
        likely: 0..1, that the things are called so.
        doubt: what is taken for what the group calls, where that is not sure; "" where it is.
    """

    ids: tuple[int, ...]
    by_name: bool
    whole: bool = False
    suggested: bool = False
    likely: float = 1.0
    doubt: str = ""
