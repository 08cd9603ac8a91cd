"""Checks that a text is a question in English, the only language understood."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable
from typing import Literal

from fastsplat.service.query.language.words.noun_phrases import noun_phrase

NoQuestion = Literal["", "empty", "foreign", "unknown"]
"""Reason why a text is no question in English; "" for none."""

_WORD = re.compile(r"[^\W\d_]+")
_ELSEWHERE = frozenset(
    # German, French, Spanish, Italian, Portuguese, Dutch: words of grammar that are no English words.
    "wo ist sind der das dem den des ein eine einen einer und mit auf unter neben welche welcher welches wie viele "
    "où est sont le la les une un des du et avec sur sous dans quelle quel combien qui "
    "dónde donde está están el los las una unos unas y con sobre debajo cuántos cuántas cuál "
    "dove è sono il lo gli uno sotto sopra quanti quante quale "
    "onde está os um uma com embaixo quantos quantas "
    "waar het een zijn op onder naast hoeveel welke".split()
) - frozenset("un den sous".split())
_SHARE = 0.5
_CLOSED = frozenset(
    "a an the this that these those my your his her its our their some any it i you he she we they me what which who "
    "whose where when how why is are am was were be do does did of in on at to for from with by and or not no "
    "please s".split()
)
"""Words that name nothing by themselves."""
_INDEFINITE = frozenset("something anything everything".split())
"""English words that no lexicon of names has."""


def is_foreign(text: str) -> bool:
    """True if a text is in another language, by its function words or script."""
    words = [word.casefold() for word in _WORD.findall(noun_phrase(text))]
    if not words:
        return False
    if any(not unicodedata.name(letter, "").startswith("LATIN") for word in words for letter in word):
        return True
    foreign = [word in _ELSEWHERE for word in words]
    return len(words) > 1 and (foreign[0] or sum(foreign) >= _SHARE * len(words))


def names_nothing(text: str) -> bool:
    """True if no word of a text could name anything: "of the", "?!"."""
    return all(word.casefold() in _CLOSED for word in re.findall(r"\w+", noun_phrase(text)))


def no_question(text: str, is_word: Callable[[str], bool] | None) -> NoQuestion:
    """Reason why a text is no question in English; "" for none.

    `is_word` tells if a word is known; None: all count as known."""
    if names_nothing(text):
        return "empty"
    if is_foreign(text):
        return "foreign"
    words = [word.casefold() for word in _WORD.findall(noun_phrase(text))]
    known = is_word is None or any(word in _INDEFINITE or is_word(word) for word in words)
    return "" if known else "unknown"
