"""What a query says: checks on the text, and the name inside a question."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Sequence

from fastsplat_contract.errors import InvalidInputError, LimitExceededError

_QUESTION = re.compile(
    r"^(?:please|where(?:'s| is| are)|what(?:'s| is| are)|which(?: is| are)?|is there|are there"
    r"|is(?= (?:the|a|an|my|your|our|any) )|(?:can|do) you see|can you (?:find|show)(?: me)?|find(?: me)?|show(?: me)?"
    r"|locate|look for|search for|point (?:at|to)|go to|bring me|give me|i(?:'m| am) looking for)\s+",
    re.IGNORECASE,
)
_ARTICLE = re.compile(
    r"^(?:a|an|the|my|your|our|their|his|her|its|this|that|these|those|some|any|every|each|all(?: of)? the)\s+",
    re.IGNORECASE,
)
_ENDING = re.compile(
    r"\s+(?:please|here|there|in here|in (?:the|this) (?:scene|room|picture|image|view))$", re.IGNORECASE
)
_TAIL = re.compile(
    r"\s+(?:on|in|inside|under|below|above|behind|beside|near|next to|in front of|at|by|from|with|without|of|for|to"
    r"|that|which)\s.*$",
    re.IGNORECASE,
)
_EDGE = " \t\n\r\f\v?!.,;:\"'`“”‘’«»¿¡()[]"


def check_texts(texts: Sequence[str], *, max_texts: int, max_chars: int) -> None:
    """Refuse what cannot be asked.

    Raises:
        InvalidInputError: no texts, a bare string in place of a list, not a string, nothing but blanks, control
            characters or lone surrogates.
        LimitExceededError: too many texts, or one too long.
    """
    if isinstance(texts, str | bytes) or not isinstance(texts, Sequence):
        raise InvalidInputError("texts is not a list of strings", field="texts", hint='Send ["mug"], not "mug".')
    if not texts:
        raise InvalidInputError("no text to look for", field="texts", hint="Send at least one.")
    if len(texts) > max_texts:
        raise LimitExceededError(
            f"{len(texts)} texts",
            field="texts",
            limit=f"{max_texts} texts (FASTSPLAT_QUERY__MAX_TEXTS)",
            hint="Ask in several requests.",
        )
    for text in texts:
        _check_text(text, max_chars)


def check_negatives(negatives: Sequence[str], *, max_prompts: int, max_chars: int) -> None:
    """Refuse canonical negatives that cannot be embedded; raises as `check_texts`."""
    _check_prompts(negatives, "negatives", max_prompts, max_chars)


def check_templates(templates: Sequence[str], *, max_prompts: int, max_chars: int) -> None:
    """Refuse sentences that are no templates; raises as `check_texts`, and for one without exactly one "{}"."""
    _check_prompts(templates, "templates", max_prompts, max_chars)
    for template in templates:
        if template.count("{}") != 1:
            raise InvalidInputError(
                f"the template {template[:80]!r}", field="templates", hint='Put exactly one "{}" where the name goes.'
            )


def _check_prompts(prompts: Sequence[str], field: str, max_prompts: int, max_chars: int) -> None:
    if isinstance(prompts, str | bytes) or not isinstance(prompts, Sequence) or not prompts:
        raise InvalidInputError(
            f"{field} is not a list of strings", field=field, hint="Send at least one, or leave it out."
        )
    if len(prompts) > max_prompts:
        raise LimitExceededError(
            f"{len(prompts)} {field}",
            field=field,
            limit=f"{max_prompts} (FASTSPLAT_QUERY__MAX_PROMPTS)",
            hint="Choose the ones that matter.",
        )
    for prompt in prompts:
        _check_text(prompt, max_chars, field)


def _check_text(text: str, max_chars: int, field: str = "text") -> None:
    if not isinstance(text, str):
        raise InvalidInputError(f"a text of type {type(text).__name__}", field=field, hint="Send a string.")
    if len(text) > max_chars:
        raise LimitExceededError(
            f"a text of {len(text)} characters",
            field=field,
            limit=f"{max_chars} characters (FASTSPLAT_QUERY__MAX_TEXT_CHARS)",
            hint="Name the thing in a few words.",
        )
    categories = {unicodedata.category(letter) for letter in text if letter not in "\t\n\r"}
    if categories & {"Cc", "Cs"}:
        raise InvalidInputError(
            "a text with control characters or lone surrogates", field=field, hint="Send printable Unicode."
        )
    if all(category[0] in "ZC" for category in categories):
        raise InvalidInputError("an empty text", field=field, hint="Say what to look for, e.g. 'mug'.")


def noun_phrase(text: str) -> str:
    """The text without question words, articles, politeness and punctuation around it: "where is the mug?" → "mug".

    English only; other languages pass through. Never empty: a text of nothing else stays as it is.
    """
    phrase = " ".join(text.split())
    while True:
        shorter = phrase.strip(_EDGE)
        for pattern in (_QUESTION, _ARTICLE, _ENDING):
            shorter = pattern.sub("", shorter, count=1)
        if not shorter.strip(_EDGE):
            return phrase
        if shorter == phrase:
            return phrase
        phrase = shorter


def candidate_names(text: str) -> Iterator[str]:
    """Names to look up in the hash table, most literal first: the text, its noun phrase, the phrase's head ("the mug
    on the table" → "mug")."""
    yield text
    phrase = noun_phrase(text)
    yield phrase
    head = _TAIL.sub("", phrase)
    if head:
        yield head
