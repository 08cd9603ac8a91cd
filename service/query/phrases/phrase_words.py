"""English closed-class words of questions: prepositions, sizes, ordinals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from fastsplat.service.query.phrases.phrases import OrderKind, RelationKind, SizeKind

MarkerKind = Literal["relation", "side", "distance", "of", "with", "says", "by", "not", "is", "rest"]


@dataclass(frozen=True)
class Marker:
    """Words that end a noun group.

    Attributes:
        kind: "side": "on the left" (of nothing), "from the left"; "distance": "nearest to"; "is": "that are"; "says":
            "labeled", before its text; "by": the same, if the words are written on something; "rest": ends parsing.
    """

    kind: MarkerKind
    relation: RelationKind | None = None  # of a relation
    negated: bool = False  # "without"; "is not"
    most: bool = False  # of a side, the right one; of a distance, the farthest
    descriptive: bool = False  # of "rest": a question of meaning ("to drink from"), not an unmeasured preposition


_RELATIONS: Mapping[RelationKind, str] = {
    "on": "on, upon, atop, on top of",
    "in": "in, inside, inside of, within",
    "under": "under, underneath, below, beneath",
    "above": "above, over",
    "next_to": "next to, beside, adjacent to, alongside",
    "near": "near, near to, close to",
    "left_of": "left of, to the left of, on the left of, at the left of, on the left side of, to the left side of",
    "right_of": "right of, to the right of, on the right of, at the right of, on the right side of, "
    "to the right side of",
    "in_front_of": "in front of",
    "behind": "behind, in back of",
    "between": "between, in between",
}
_SIDES = (
    "on the {}",
    "to the {}",
    "at the {}",
    "on the {} side",
    "on the far {}",
    "to the far {}",
    "from the {}",
    "from {}",
)
_NOT = ("not", "that is not", "that are not", "which is not", "which are not", "is not", "are not", "isn't", "aren't")
_SAYS = (
    "that says, which says, that say, which say, that reads, which reads, says, saying, labeled, labelled, marked, "
    "titled, entitled, with the word, with the words, with the text, with the title"
)
_PRONOUNS = "i you he she we they people someone somebody could would should will might may must"
_DESCRIPTIVE = f"to for that which who whose when where because like but except {_PRONOUNS}"
_UNMEASURED = "at from against around outside across through along toward towards opposite facing than beyond off"


def _markers() -> dict[tuple[str, ...], Marker]:
    table = {word: Marker("rest", descriptive=True) for word in _DESCRIPTIVE.split()}
    table |= {word: Marker("rest") for word in _UNMEASURED.split()}
    table |= {phrase: Marker("says") for phrase in _SAYS.split(", ")} | {"by": Marker("by")}
    for relation, phrases in _RELATIONS.items():
        table |= {phrase: Marker("relation", relation) for phrase in phrases.split(", ")}
    for side in ("left", "right"):
        table |= {form.format(side): Marker("side", most=side == "right") for form in _SIDES}
    for word in ("nearest", "closest"):
        table |= {f"{word}{to}": Marker("distance") for to in ("", " to")}
    for word in ("farthest", "furthest"):
        table |= {f"{word}{end}": Marker("distance", most=True) for end in ("", " from", " away from", " away")}
    table |= {"of": Marker("of"), "full of": Marker("of"), "filled with": Marker("of")}
    table |= {"with": Marker("with"), "having": Marker("with"), "containing": Marker("of")}
    table |= {phrase: Marker("with", negated=True) for phrase in ("without", "with no", "lacking", "without any")}
    table |= {phrase: Marker("not") for phrase in _NOT}
    table |= {
        phrase: Marker("is") for phrase in ("that is", "that are", "which is", "which are", "is", "are", "that's")
    }
    return {tuple(phrase.split()): marker for phrase, marker in table.items()}


MARKERS = _markers()
"""Markers by their words; the longest match counts."""
LONGEST_MARKER = max(map(len, MARKERS))

DETERMINERS = frozenset(
    "a an the my your our their his her its this that these those some any every each all both".split()
)
DEFINITE = frozenset("the my your our their his her its this that".split())
ASKER = frozenset("me us myself here".split())
"""Words for the asker as an anchor."""
ANYTHING = frozenset(
    "thing things object objects item items something anything everything what whatever one ones stuff".split()
)
COUNTED = frozenset("pair pairs piece pieces bunch set sets couple kind sort type stack pile".split())
"""Words before "of" that belong to the name: "a pair of scissors"."""
UNMEASURED_MODIFIERS = frozenset(
    "old new empty full open closed broken clean dirty two three four five six seven eight nine ten several many both "
    "other another thick thin bright".split()
)
POSTPOSED = frozenset("something anything everything what whatever".split())
"""Words before their modifiers: "something red"."""

SIZES: Mapping[str, tuple[SizeKind, bool]] = {
    **dict.fromkeys(("big", "large", "huge", "bigger", "larger"), ("size", True)),
    **dict.fromkeys(("small", "little", "tiny", "smaller"), ("size", False)),
    **dict.fromkeys(("tall", "taller"), ("height", True)),
    **dict.fromkeys(("short", "shorter"), ("height", False)),
    **dict.fromkeys(("long", "longer"), ("length", True)),
    **dict.fromkeys(("wide", "wider"), ("width", True)),
    "narrow": ("width", False),
}
"""Comparative sizes: kind, and True for the larger ones."""

SUPERLATIVES: Mapping[str, tuple[OrderKind, bool]] = {
    **dict.fromkeys(("largest", "biggest"), ("size", True)),
    **dict.fromkeys(("smallest", "littlest", "tiniest"), ("size", False)),
    "tallest": ("height", True),
    "shortest": ("height", False),
    "longest": ("length", True),
    "widest": ("width", True),
    "narrowest": ("width", False),
    **dict.fromkeys(("highest", "topmost", "uppermost"), ("elevation", True)),
    **dict.fromkeys(("lowest", "bottommost"), ("elevation", False)),
    **dict.fromkeys(("nearest", "closest"), ("distance", False)),
    **dict.fromkeys(("farthest", "furthest"), ("distance", True)),
    **dict.fromkeys(("leftmost", "left-most"), ("from_left", False)),
    **dict.fromkeys(("rightmost", "right-most"), ("from_left", True)),
}
"""Orders: kind, and True for the largest first."""

_ORDINALS = "first/1st second/2nd third/3rd fourth/4th fifth/5th sixth/6th seventh/7th eighth/8th ninth/9th tenth/10th"
ORDINALS: Mapping[str, int] = {
    word: number for number, words in enumerate(_ORDINALS.split(), start=1) for word in words.split("/")
}
