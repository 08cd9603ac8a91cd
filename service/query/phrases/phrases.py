"""Parsed questions: colors, sizes, relations, order and number beside a name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from fastsplat_contract.messages.phrases import Asks

RelationKind = Literal[
    "on", "in", "under", "above", "next_to", "near", "left_of", "right_of", "in_front_of", "behind", "between"
]
SizeKind = Literal["size", "height", "length", "width"]
OrderKind = Literal["size", "height", "length", "width", "elevation", "distance", "from_left"]

SEEN_FROM: frozenset[RelationKind] = frozenset({"left_of", "right_of", "in_front_of", "behind"})
"""Relations that depend on where the asker stands."""


@dataclass(frozen=True)
class ColorWord:
    """A color, "light blue", or a denied one, "not red"."""

    name: str  # of the color, as in `color_names`
    shade: str = ""  # "", "light" or "dark"
    negated: bool = False  # whether the phrase denies it

    @property
    def text(self) -> str:
        return " ".join(word for word in ("not" if self.negated else "", self.shade, self.name) if word)


@dataclass(frozen=True)
class SizeWord:
    """A size relative to others of the kind: "big" in "the big mug"."""

    word: str  # as asked
    by: SizeKind  # what is compared
    more: bool  # whether it asks for the larger ones


@dataclass(frozen=True)
class Relation:
    """A relation to other objects: "on the table", "between the lamp and the mug"."""

    kind: RelationKind  # of the relation
    anchors: tuple[Phrase, ...]  # what it is related to; none: the asker
    negated: bool  # whether the phrase denies it
    text: str  # as asked

    @property
    def is_of_pose(self) -> bool:
        """True if it depends on where the asker stands."""
        return self.kind in SEEN_FROM or not self.anchors


@dataclass(frozen=True)
class Possession:
    """A part or another object ("with a handle"), or a content ("of water")."""

    kind: Literal["with", "of"]  # "with" or "of"
    phrase: Phrase  # what it has
    negated: bool  # whether the phrase denies it: "without a handle"
    text: str  # as asked


@dataclass(frozen=True)
class Says:
    """Writing on an object: "that says oat milk", "by Woolf"."""

    words: str  # that are written there
    negated: bool  # whether the phrase denies it
    text: str  # as asked


@dataclass(frozen=True)
class Rank:
    """One of an order: "the second largest", "second from the left", "nearest to the lamp"."""

    by: OrderKind  # what they are ordered by
    descending: bool  # whether the most is first; from the right, for "from_left"
    number: int  # which one, 1 is the first
    anchors: tuple[Phrase, ...] = ()  # of "distance", from what; none: from the asker
    text: str = ""  # as asked


Condition = Relation | Possession | Says


@dataclass(frozen=True)
class Phrase:
    """A noun phrase."""

    head: str  # the noun group, without the modifiers below: "coffee machine"; "" for anything at all
    group: str  # the noun group with its colors and sizes, as asked: "big red mug", which may be a name
    definite: bool = False  # whether it speaks of one that is known: "the lamp"; "lamps", "a lamp" and "lamp" are not
    colors: tuple[ColorWord, ...] = ()
    sizes: tuple[SizeWord, ...] = ()
    conditions: tuple[Condition, ...] = ()
    rank: Rank | None = None  # which one of them; None for all

    @property
    def inner(self) -> tuple[Phrase, ...]:
        """Phrases in its conditions and its order."""
        phrases = [*self.rank.anchors] if self.rank is not None else []
        for condition in self.conditions:
            phrases += [condition.phrase] if isinstance(condition, Possession) else []
            phrases += condition.anchors if isinstance(condition, Relation) else ()
        return tuple(phrases)

    @property
    def is_of_pose(self) -> bool:
        """True if what it names may depend on where the asker stands."""
        relations = [condition for condition in self.conditions if isinstance(condition, Relation)]
        return (
            any(relation.is_of_pose for relation in relations)
            or (self.rank is not None and self.rank.by in ("from_left", "distance"))
            or any(phrase.is_of_pose for phrase in self.inner)
        )

    @property
    def said(self) -> tuple[str, ...]:
        """The modifiers in words."""
        words = [color.text for color in self.colors] + [size.word for size in self.sizes]
        words += [condition.text for condition in self.conditions]
        return tuple(words if self.rank is None else [*words, self.rank.text])


@dataclass(frozen=True)
class ParsedQuestion:
    """A question that says more than a name."""

    asks: Asks  # whether it asks which objects, or how many
    readings: tuple[Phrase, ...]  # with one head; "the mug on the table next to the lamp" has two
    not_understood: str  # the words that were left over; "" without

    @property
    def is_of_pose(self) -> bool:
        """True if what it names may depend on where the asker stands."""
        return any(reading.is_of_pose for reading in self.readings)

    @property
    def of_writing(self) -> bool:
        """True if it may ask for writing on objects."""
        return any(isinstance(condition, Says) for reading in self.readings for condition in reading.conditions)


@dataclass(frozen=True)
class Named:
    """The objects that a noun group names."""

    ids: tuple[int, ...]  # of objects and parts
    by_name: bool  # whether it is their name, or an alias; False for what was found by meaning
    whole: bool = False  # whether the name has the colors and sizes of the group in it: "red mug" is a name here
    suggested: bool = False  # whether the name is merely suggested for them
    likely: float = 1.0  # 0..1, that the objects are called so
    doubt: str = ""  # what is taken for what the group calls, where that is not sure; "" where it is
