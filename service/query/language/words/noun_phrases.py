"""Noun phrase grammar of questions: heads and their details. English only; other languages pass through as one head."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from fastsplat.service.common.dictionary import label_key

_ADDRESS = re.compile(
    r"^(?:(?:hi|hello|hey|okay|ok|well|so|sorry|excuse me|please|kindly|just|maybe)[\s,]+"
    r"|(?:can|could|will|would|do|did|does|have|has|might) (?:you|we|i|anyone|anybody|someone|somebody)\s+"
    r"(?=(?:please|kindly|maybe|just|already|ever|also|see|seen|find|found|spot|spotted|show|tell|know|locate|point|look"
    r"|search|help|have|got|bring|give|get|pass|hand)\s)|(?:already|ever|also)\s+(?=seen|see|got)"
    r"|(?:tell|show|help|remind)(?: me| us)?\s+(?=(?:what|where|which|how|whether|if|find|locate|see)\s)"
    r"|(?:know|see|remember|whether|if)\s+(?=(?:what|where|which|how|there|the|my|your|our|any|an?)\s)"
    r"|(?:i|we)(?:'m| am|'re| are)? (?:looking for|after|searching for|trying to (?:find|locate))\s+"
    r"|(?:i|we)(?:'d| would)? (?:just )?(?:need|want|like|have lost|lost|miss|can't find|cannot find)(?: to)?\s+)",
    re.IGNORECASE,
)
_QUESTION = re.compile(
    r"^(?:where(?:'s| is| are| did| has| have)|where (?:can|could|might|may) (?:i|we|you|one) (?:find|see|get)"
    r"|where(?: can| could| might| may)?(?= (?:the|a|an|my|your|our|any|this|that) )|what(?:'s| is| are)"
    r"|which(?: is| are)?|is there|are there|there is|there are|there's"
    r"|is(?= (?:the|a|an|my|your|our|any) )|(?:find|show|get|bring|give|pass|hand)(?: me| us)?|see|seen|spotted"
    r"|have|got|locate|look for|search for|point (?:me |us )?(?:at|to)|go to)\s+",
    re.IGNORECASE,
)
_ARTICLE = re.compile(
    r"^(?:a|an|the|my|your|our|their|his|her|its|this|that|these|those|some|any|every|each|all(?: of)? the|one of the"
    r"|nice|lovely|beautiful|pretty|cute|adorable|gorgeous|wonderful|favou?rite)\s+",
    re.IGNORECASE,
)
"""Determiners and opinions before a noun."""
_ENDING = re.compile(
    r"\s+(?:please|thanks|thank you|here|there|anywhere|somewhere|around here|at all|for me|in here"
    r"|in (?:the|this) (?:scene|room|picture|image|view|photos?)"
    r"|(?<!where )(?<!what )(?<!which )(?:is|are|be|might be|could be|may be|can be)|go|went)$",
    re.IGNORECASE,
)
_EDGE = " \t\n\r\f\v?!.,;:\"'`“”‘’«»¿¡()[]"

_NEGATORS = "without|except(?: for)?|excluding|instead of|rather than|other than|(?:but |and )?not|no"
_RELATORS = (
    r"(?:full|made|filled|covered) (?:of|with|in)|of|for|with|on top of|on|inside|in front of|in|underneath|under|below"
    r"|above|behind|beside|besides|between|near|next to|at|by|from|to|over|around|against|outside|that|which|who|whose"
    r"|wearing|holding|carrying|containing|lying|sitting|standing|hanging"
)
_NEGATOR = re.compile(_NEGATORS, re.IGNORECASE)
_CONNECTOR = re.compile(rf"(?:^|(?<=\s))({_NEGATORS}|{_RELATORS})(?:\s+|$)", re.IGNORECASE)
_COORDINATION = re.compile(r"\s*,\s*(?:and\s+|or\s+)?|\s+(?:and|or)\s+", re.IGNORECASE)

_COLORS = frozenset(
    "red orange yellow green blue purple violet pink brown black white gray grey beige turquoise golden silver".split()
)
_SHADES = frozenset("light dark bright pale".split())
_PLAIN = _COLORS | frozenset(
    "big large huge small little tiny tall long short wide narrow thick thin old new empty full open closed broken "
    "clean dirty two three four five six seven eight nine ten several many both other another colored coloured".split()
)
"""Modifiers that select among a class without making another class of it.

Materials are excluded (a wooden horse is no horse, a paper towel no towel), as are words common in names (hot dog, high
chair)."""


@dataclass(frozen=True)
class Detail:
    """A prepositional phrase or relative clause about a head."""

    connector: str  # the word before it, folded: "of", "on", "without"
    groups: tuple[str, ...]  # the noun groups that follow, articles off: "lid"
    negated: bool  # whether the phrase denies it


@dataclass(frozen=True)
class NounPhrase:
    """The parts of a question."""

    text: str  # the question without question words, articles, politeness and punctuation around it
    heads: tuple[str, ...]  # the noun groups that are asked for; "fork and knife" has two, "on the bed" none
    details: tuple[Detail, ...]  # what is said of them, in order
    tail: str  # the text of all details, with their connectors; "" without


def noun_phrase(text: str) -> str:
    """Strips question words, articles, politeness and punctuation: "where is the mug?" → "mug".

    Never empty: a text of nothing else stays unchanged."""
    return _without((_ADDRESS, _QUESTION, _ARTICLE, _ENDING), text)


def without_address(text: str) -> str:
    """Strips the form of address: "could you tell me where ..." → "where ..."."""
    return _without((_ADDRESS,), text)


def _without(patterns: Sequence[re.Pattern[str]], text: str) -> str:
    phrase = " ".join(text.split())
    while True:
        shorter = phrase.strip(_EDGE)
        for pattern in patterns:
            shorter = pattern.sub("", shorter, count=1)
        if not shorter.strip(_EDGE):
            return phrase
        if shorter == phrase:
            return phrase
        phrase = shorter


def parse_noun_phrase(text: str) -> NounPhrase:
    """Parses heads and details: "kettle without a lid" → head "kettle", negated detail "lid".

    In English the head noun precedes prepositions and relative clauses, and is last in its own group."""
    phrase = noun_phrase(text)
    connectors = list(_CONNECTOR.finditer(phrase))
    starts = [connector.start() for connector in connectors] + [len(phrase)]
    details = tuple(
        Detail(
            connector=connector[1].casefold(),
            groups=noun_groups(phrase[connector.end() : end]),
            negated=_NEGATOR.fullmatch(connector[1]) is not None,
        )
        for connector, end in zip(connectors, starts[1:], strict=True)
    )
    return NounPhrase(phrase, noun_groups(phrase[: starts[0]]), details, phrase[starts[0] :].strip())


def noun_groups(text: str) -> tuple[str, ...]:
    """Splits an enumeration, articles off: "a fork, or the knife" → "fork", "knife"."""
    return tuple(noun_phrase(part) for part in _COORDINATION.split(text) if part.strip(_EDGE))


def split_modifiers(group: str) -> tuple[frozenset[str], str]:
    """Splits plain modifiers from the singular rest: "big red mugs" → {big, red}, "mug"."""
    words = label_key(group).split(" ")
    modifiers = 0
    while modifiers < len(words) - 1:
        if words[modifiers] in _PLAIN:
            modifiers += 1
        elif words[modifiers] in _SHADES and words[modifiers + 1] in _COLORS and modifiers + 2 < len(words):
            modifiers += 2
        else:
            break
    return frozenset(words[:modifiers]), " ".join(words[modifiers:])
