"""Parser of questions: head, colors, sizes, relations, order and number (English closed-class words).

A noun group ends at the first preposition; what follows modifies the head or an object named before it, and both are
readings. Purposes ("something to drink from") are not parsed: they are questions of meaning for the text encoder."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.language.words.name_matching import NameIndex
from fastsplat.service.query.language.words.noun_phrases import noun_phrase, without_address
from fastsplat.service.query.objects.color_names import NAMES, SHADES
from fastsplat.service.query.phrases.phrases import (
    ColorWord,
    Condition,
    OrderKind,
    ParsedQuestion,
    Phrase,
    Possession,
    Rank,
    Relation,
    RelationKind,
    Says,
    SizeKind,
    SizeWord,
)
from fastsplat.service.query.phrases.written_words import WrittenWords, asked_of_writing
from fastsplat_contract.messages.phrases import Asks

MAX_WORDS = 64
"""Longer texts are taken for descriptions."""
MAX_CONDITIONS = 4
"""Further conditions of a question are not understood."""

_COUNTING = re.compile(r"^\W*how\s+many\s+", re.IGNORECASE)
_ARE_THERE = re.compile(r"\s+(?:(?:are|is)\s+(?:there|here)|(?:do|can)\s+(?:you|i|we)\s+see)\b", re.IGNORECASE)
_OF_WHICH = re.compile(r"^(?:which|one|any|all|some)(?:\s+one)?\s+of\s+(?=(?:the|my|our|your)\s)", re.IGNORECASE)
_WHAT_IS = re.compile(r"^\W*(?:what|which)(?:'s|\s+is|\s+are)\s+", re.IGNORECASE)
IsName = Callable[[str], bool]
"""Tells if some words are the name of something."""
_NOTHING_WRITTEN = WrittenWords(())
_EDGE = "?!.,;:\"'`“”‘’«»¿¡()[]"
_JOINTS = frozenset({"and", "but", "or", ","})

_MarkerKind = Literal["relation", "side", "distance", "of", "with", "says", "by", "not", "is", "rest"]


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
    "on the {}", "to the {}", "at the {}", "on the {} side", "on the far {}", "to the far {}", "from the {}", "from {}",
)  # fmt: skip
_NOT = ("not", "that is not", "that are not", "which is not", "which are not", "is not", "are not", "isn't", "aren't")
_SAYS = (
    "that says, which says, that say, which say, that reads, which reads, says, saying, labeled, labelled, marked, "
    "titled, entitled, with the word, with the words, with the text, with the title"
)
_PRONOUNS = "i you he she we they people someone somebody could would should will might may must"
_DESCRIPTIVE = f"to for that which who whose when where because like but except {_PRONOUNS}"
_UNMEASURED = "at from against around outside across through along toward towards opposite facing than beyond off"

_DETERMINERS = frozenset(
    "a an the my your our their his her its this that these those some any every each all both".split()
)
_DEFINITE = frozenset("the my your our their his her its this that".split())
_ASKER = frozenset("me us myself here".split())
"""Words for the asker as an anchor."""
_ANYTHING = frozenset(
    "thing things object objects item items something anything everything what whatever one ones stuff".split()
)
_COUNTED = frozenset("pair pairs piece pieces bunch set sets couple kind sort type stack pile".split())
"""Words before "of" that belong to the name: "a pair of scissors"."""
_UNMEASURED_MODIFIERS = frozenset(
    "old new empty full open closed broken clean dirty two three four five six seven eight nine ten several many both "
    "other another thick thin bright".split()
)
_POSTPOSED = frozenset("something anything everything what whatever".split())
"""Words before their modifiers: "something red"."""

_SIZES: Mapping[str, tuple[SizeKind, bool]] = {
    **dict.fromkeys(("big", "large", "huge", "bigger", "larger"), ("size", True)),
    **dict.fromkeys(("small", "little", "tiny", "smaller"), ("size", False)),
    **dict.fromkeys(("tall", "taller"), ("height", True)),
    **dict.fromkeys(("short", "shorter"), ("height", False)),
    **dict.fromkeys(("long", "longer"), ("length", True)),
    **dict.fromkeys(("wide", "wider"), ("width", True)),
    "narrow": ("width", False),
}
"""Comparative sizes: kind, and True for the larger ones."""

_SUPERLATIVES: Mapping[str, tuple[OrderKind, bool]] = {
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


@dataclass
class _Part:
    """A marker with the words up to the next one."""

    marker: _Marker | None  # None for what the text begins with
    said: str = ""  # the words of the marker, as asked
    words: list[str] = field(default_factory=list)  # those after it
    joined: bool = False  # whether an "and" stands before it, so that it is said of the head
    negated: bool = False  # whether a "not" stands before it

    @property
    def text(self) -> str:
        """Marker and words, as asked."""
        return " ".join([*(["not"] if self.negated else []), self.said, *self.words]).strip()


@dataclass(frozen=True)
class _Group:
    """A noun group, and an ordinal whose rank comes later ("the second mug from ...")."""

    phrase: Phrase
    number: int | None


@dataclass(frozen=True)
class _Item:
    """A condition or rank without a target; the next may modify its last anchor."""

    part: _Part
    anchors: tuple[Phrase, ...]


def parse_question(
    text: str, is_name: IsName = lambda _: False, written: WrittenWords = _NOTHING_WRITTEN
) -> ParsedQuestion | None:
    """Parses what a question says beyond a name; None for plain names and descriptions.

    A color in a name ("red wine", "orange juice") belongs to it. The cost is linear in the words (at most 64), with at
    most fourteen readings of four conditions."""
    text = without_address(text)
    asks: Asks = "count" if _COUNTING.match(text) else "objects"
    question = asked_of_writing(_COUNTING.sub("", text))
    words = noun_phrase(_OF_WHICH.sub("", _ARE_THERE.sub("", question) if asks == "count" else question)).split()
    if not words or len(words) > MAX_WORDS:
        return None
    parts, rest = _parts(words, written)
    described = rest is not None and rest.marker is not None and rest.marker.descriptive
    head_words = parts[0].words
    if described and len(parts) == 1 and rest is not None:
        if not head_words:
            return None
        head_words, rest = [*head_words, *rest.text.split()], None
    sided = any(part.marker is not None and part.marker.kind == "side" for part in parts)
    asking = bool(_WHAT_IS.match(text)) or (sided and head_words[-1:] and head_words[-1].casefold() in ORDINALS)
    group = _noun_group(head_words, is_name, asking=bool(asking), described=described and rest is None)
    head, items, leftover = _items(group, parts[1:], is_name)
    leftover += [] if rest is None else [rest.text]
    readings = tuple(_assembled(head, items, parents) for parents in _attachments(items))
    if asks == "objects" and not any(r.colors or r.sizes or r.conditions or r.rank for r in readings):
        denied = len(parts) > 1 and all(part.marker is not None and part.marker.kind == "not" for part in parts[1:])
        if described or denied or not leftover:  # "mug, not the glass" is for the names of the dictionary
            return None
    return ParsedQuestion(asks, readings, " ".join(leftover))


def parsed_questions(
    texts: Sequence[str], names: NameIndex, is_name: IsName = lambda _: False, written: WrittenWords = _NOTHING_WRITTEN
) -> tuple[ParsedQuestion | None, ...]:
    """Parses each text; None for plain ones and names like "can of paint"."""
    parsed = []
    for text in texts:
        question = None if names.has(text) else parse_question(text, is_name, written)
        if question is not None and question.asks == "objects":
            match = names.match(text)
            question = None if match.exact and not match.unchecked else question
        parsed.append(question)
    return tuple(parsed)


def _parts(words: Sequence[str], written: WrittenWords) -> tuple[list[_Part], _Part | None]:
    """Splits a text at markers; the second result is the unparsed rest."""
    keys = [word.strip(_EDGE).casefold().replace("’", "'") for word in words]
    parts = [_Part(None)]
    at = 0
    while at < len(words):
        marker, length = _marker_at(keys, at, parts[-1].words)
        if marker is None:
            parts[-1].words.append(words[at].strip(_EDGE.replace(",", "")))
            at += 1
            continue
        said = " ".join(words[at : at + length])
        if marker.kind in ("says", "by"):
            after = words[at + length :]
            count = written.leading(after)
            end = at + length + count
            if not count or (end < len(words) and _marker_at(keys, end, after[:count])[0] is None):
                count = len(after) if marker.kind == "says" else 0
            if count:
                quoted_words = [word.strip(_EDGE) for word in after[:count]]
                parts.append(_Part(_Marker("says"), said, quoted_words, joined=_without_joint(parts[-1])))
                at += length + count
                continue
            marker = _Marker("rest")
        if marker.kind == "rest":
            return parts, _Part(marker, said, list(words[at + length :]))
        joined = _without_joint(parts[-1])
        parts.append(_Part(marker, said, joined=joined))
        at += length
    _without_joint(parts[-1])
    return parts, None


def _marker_at(keys: Sequence[str], at: int, before: Sequence[str]) -> tuple[_Marker | None, int]:
    """The longest marker at a position, and its number of words."""
    for length in range(min(_LONGEST_MARKER, len(keys) - at), 0, -1):
        marker = MARKERS.get(tuple(keys[at : at + length]))
        if marker is None:
            continue
        after = keys[at + length] if at + length < len(keys) else ""
        nouns = [word for word in before if word.casefold() not in _DETERMINERS]
        if marker.kind == "distance" and length == 1 and not nouns and after and after not in _DETERMINERS:
            return None, 0  # "the nearest mug"
        if marker.kind == "of" and length == 1 and nouns and label_key(nouns[-1]) in _COUNTED:
            return None, 0  # "a pair of scissors"
        orders = (_SUPERLATIVES.get(word.casefold(), ("",))[0] for word in before)
        if marker.kind == "rest" and keys[at] in ("to", "from") and "distance" in orders:
            return _Marker("distance"), 1  # "the nearest mug to the lamp"
        return marker, length
    return None, 0


def _without_joint(part: _Part) -> bool:
    """Strips "and" off the end of a part; returns True if there was one."""
    joined = False
    while part.words and part.words[-1].strip(_EDGE).casefold() in _JOINTS | {""}:
        part.words.pop()
        joined = True
    if part.words:
        part.words[-1] = part.words[-1].rstrip(",")
    return joined


def _items(group: _Group, parts: Sequence[_Part], is_name: IsName) -> tuple[Phrase, list[_Item], list[str]]:
    """Head with predicates ("is red"), conditions in order, and leftover words."""
    head, number = group.phrase, group.number
    items: list[_Item] = []
    leftover: list[str] = []
    negated = False
    for part in parts:
        assert part.marker is not None
        if part.marker.kind in ("is", "not"):
            negated = negated or part.marker.negated or part.marker.kind == "not"
            if part.words:
                said = _predicate(head, part.words, negated)
                leftover += [part.text] if said is None else []
                head, number = (head, number) if said is None else (said.phrase, said.number or number)
                negated = False
            continue
        part.negated, negated = negated, False
        if len(items) == MAX_CONDITIONS:
            leftover.append(part.text)
        elif part.marker.kind == "side":
            ranked = replace(head, rank=Rank("from_left", part.marker.most, number or 1, (), part.text))
            unclear = part.words or part.negated or head.rank is not None
            leftover += [part.text] if unclear else []
            head, number = (head, number) if unclear else (ranked, None)
        elif part.marker.kind == "says":
            items.append(_Item(part, ()))
        elif part.marker.kind == "distance" and head.rank is not None and head.rank.by == "distance":
            anchors = _anchors(part, is_name)
            clear = bool(anchors) and not head.rank.anchors and not part.negated
            leftover += [] if clear else [part.text]
            if clear:
                rank = head.rank
                head = replace(head, rank=replace(rank, anchors=anchors, text=f"{rank.text} {part.text}"))
                items += [_Item(part, anchors)]
        else:
            anchors = _anchors(part, is_name)
            needs = part.marker.kind in ("of", "with") or (part.marker.relation == "between")
            if (not anchors and needs) or (not part.words and part.marker.kind != "distance"):
                leftover.append(part.text)
            else:
                items.append(_Item(part, anchors))
    if number is not None:
        leftover.append(f"number {number}")
    return head, items, leftover


def _predicate(head: Phrase, words: Sequence[str], negated: bool) -> _Group | None:
    """Adds adjectives after "is" to the head; None if they are none."""
    group = _noun_group(words, lambda _: False, asking=True)
    said = group.phrase
    if said.head or (said.rank and (head.rank or negated)) or (said.sizes and negated):
        return None
    colors = (*head.colors, *(replace(color, negated=negated) for color in said.colors))
    grown = replace(head, colors=colors, sizes=(*head.sizes, *said.sizes), rank=said.rank or head.rank)
    return _Group(grown, group.number)


def _anchors(part: _Part, is_name: IsName) -> tuple[Phrase, ...]:
    """Anchors of a relation; empty for the asker."""
    words = [word for word in part.words if word]
    if not words or (len(words) == 1 and words[0].casefold() in _ASKER):
        return ()
    groups = [words]
    if part.marker is not None and part.marker.relation == "between":
        joint = next((at for at, word in enumerate(words) if word.casefold() == "and"), 0)
        groups = [words[:joint], words[joint + 1 :]] if 0 < joint < len(words) - 1 else groups
    return tuple(_noun_group(group, is_name).phrase for group in groups)


def _noun_group(words: Sequence[str], is_name: IsName, asking: bool = False, described: bool = False) -> _Group:
    """Parses determiners, modifiers in any order, and the final head.

    A leading color may belong to a name (`is_name`). `asking`: adjectives may stand alone ("what is red?");
    `described`: a description follows, so that "object" belongs to it and is no wildcard."""
    left = [word.rstrip(",") if number == len(words) - 1 else word for number, word in enumerate(words)]
    definite = False
    while left and (key := left[0].casefold()) in _DETERMINERS:
        definite = definite or key in _DEFINITE
        left.pop(0)
    group = " ".join(left)
    if left and left[0].casefold() in _POSTPOSED and len(left) > 1 and not described:
        left, asking = [*left[1:]], True
    if len(left) > 1 and left[-1].casefold() in ORDINALS:
        left = [left[-1], *left[:-1]]
    colors: list[ColorWord] = []
    sizes: list[SizeWord] = []
    modifiers: list[str] = []
    rank, number = None, None
    while left and (asking or len(left) > 1 or left[0].casefold() in _SUPERLATIVES):
        key = left[0].casefold()
        after = left[1].casefold() if len(left) > 1 else ""
        if key in NAMES and any(is_name(" ".join(left[:end])) for end in range(2, len(left) + 1)):
            break
        if key in SHADES and after in NAMES and (asking or len(left) > 2):
            colors.append(ColorWord(after, SHADES[key]))
            left.pop(0)
        elif key in NAMES:
            colors.append(ColorWord(key))
        elif key in _SIZES:
            sizes.append(SizeWord(key, *_SIZES[key]))
        elif key in _SUPERLATIVES and rank is None:
            ordinal = next((word for word, value in ORDINALS.items() if value == number), "") if number else ""
            rank = Rank(*_SUPERLATIVES[key], number or 1, (), f"{ordinal} {key}".strip())
            number = None
        elif key in ORDINALS and number is None and rank is None:
            number = ORDINALS[key]
        elif key in _UNMEASURED_MODIFIERS and after:
            modifiers.append(left[0])
        else:
            break
        left.pop(0)
    anything = not left or (len(left) == 1 and left[0].casefold() in _ANYTHING and not described)
    head = "" if anything and not modifiers else " ".join([*modifiers, *left])
    return _Group(
        Phrase(head, group, definite and label_key(head) == head.casefold(), tuple(colors), tuple(sizes), (), rank),
        number,
    )


def _attachments(items: Sequence[_Item]) -> Iterator[tuple[int, ...]]:
    """Yields the items' targets by reading: 0 the head (first for all), n the last anchor of item n-1."""

    def extend(parents: tuple[int, ...], edge: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        at = len(parents)
        if at == len(items):
            yield parents
            return
        item = items[at]
        bare = item.part.marker is not None and item.part.marker.kind in ("of", "with")
        own_rank = item.part.marker is not None and item.part.marker.kind == "distance"
        for level, parent in enumerate(edge[:1] if item.part.joined or own_rank else edge):
            grown = edge[: level + 1] if bare or not item.anchors else (*edge[: level + 1], at + 1)
            yield from extend((*parents, parent), grown)

    yield from extend((), (0,))


def _assembled(head: Phrase, items: Sequence[_Item], parents: Sequence[int]) -> Phrase:
    """Assembles a phrase from last item to first: later ones modify earlier ones."""
    phrases = [head, *(item.anchors[-1] if item.anchors else Phrase("", "") for item in items)]
    for at in range(len(items) - 1, -1, -1):
        part, parent = items[at].part, parents[at]
        anchors = (*items[at].anchors[:-1], phrases[at + 1]) if items[at].anchors else ()
        target = phrases[parent]
        condition = _condition(part, anchors)
        if condition is not None:
            phrases[parent] = replace(target, conditions=(condition, *target.conditions))
        elif target.rank is not None:
            phrases[parent] = replace(target, rank=replace(target.rank, anchors=anchors))
        else:
            assert part.marker is not None
            phrases[parent] = replace(target, rank=Rank("distance", part.marker.most, 1, anchors, part.text))
    return phrases[0]


def _condition(part: _Part, anchors: tuple[Phrase, ...]) -> Condition | None:
    """The condition of a part; None for a rank."""
    assert part.marker is not None
    negated = part.negated != part.marker.negated
    if part.marker.relation is not None:
        return Relation(part.marker.relation, anchors, negated, part.text)
    if part.marker.kind == "says":
        return Says(" ".join(part.words), negated, part.text)
    if part.marker.kind in ("of", "with"):
        return Possession("of" if part.marker.kind == "of" else "with", anchors[0], negated, part.text)
    return None


@dataclass(frozen=True)
class _Marker:
    """Words that end a noun group.

    Attributes:
        kind: "side": "on the left" (of nothing), "from the left"; "distance": "nearest to"; "is": "that are"; "says":
            "labeled", before its text; "by": the same, if the words are written on something; "rest": ends parsing.
    """

    kind: _MarkerKind
    relation: RelationKind | None = None  # of a relation
    negated: bool = False  # "without"; "is not"
    most: bool = False  # of a side, the right one; of a distance, the farthest
    descriptive: bool = False  # of "rest": a question of meaning ("to drink from"), not an unmeasured preposition


def _markers() -> dict[tuple[str, ...], _Marker]:
    table = {word: _Marker("rest", descriptive=True) for word in _DESCRIPTIVE.split()}
    table |= {word: _Marker("rest") for word in _UNMEASURED.split()}
    table |= {phrase: _Marker("says") for phrase in _SAYS.split(", ")} | {"by": _Marker("by")}
    for relation, phrases in _RELATIONS.items():
        table |= {phrase: _Marker("relation", relation) for phrase in phrases.split(", ")}
    for side in ("left", "right"):
        table |= {form.format(side): _Marker("side", most=side == "right") for form in _SIDES}
    for word in ("nearest", "closest"):
        table |= {f"{word}{to}": _Marker("distance") for to in ("", " to")}
    for word in ("farthest", "furthest"):
        table |= {f"{word}{end}": _Marker("distance", most=True) for end in ("", " from", " away from", " away")}
    table |= {"of": _Marker("of"), "full of": _Marker("of"), "filled with": _Marker("of")}
    table |= {"with": _Marker("with"), "having": _Marker("with"), "containing": _Marker("of")}
    table |= {phrase: _Marker("with", negated=True) for phrase in ("without", "with no", "lacking", "without any")}
    table |= {phrase: _Marker("not") for phrase in _NOT}
    table |= {
        phrase: _Marker("is") for phrase in ("that is", "that are", "which is", "which are", "is", "are", "that's")
    }
    return {tuple(phrase.split()): marker for phrase, marker in table.items()}


MARKERS = _markers()
"""Markers by their words; the longest match counts."""
_LONGEST_MARKER = max(map(len, MARKERS))
