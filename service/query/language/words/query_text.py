"""Validation of queries: texts and prompts."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass

from fastsplat.service.query.query_settings import QuerySettings
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from fastsplat_contract.messages.queries import check_coverage

MAX_TEXTS = 64
"""Most texts, templates and negatives of one request, each."""
_MAX_TEXT_CHARS = 1_000
"""Most characters of one text, negative or template."""


@dataclass(frozen=True)
class TextQuery:
    """A validated query, see `check_query`."""

    texts: tuple[str, ...]  # plain words, at least one text
    negatives: tuple[str, ...]  # canonical negatives
    templates: tuple[str, ...]  # prompt templates, each with one "{}"
    coverage: float  # of the label sets, above 0 and below 1


def check_query(
    texts: Sequence[str],
    settings: QuerySettings,
    *,
    negatives: Sequence[str] | None = None,
    templates: Sequence[str] | None = None,
    coverage: float | None = None,
) -> TextQuery:
    """Validates a query; None stands for the settings' value.

    Raises:
        InvalidInputError: an empty list or text, a bare string, a non-string, control characters or lone surrogates, a
            template without exactly one "{}", a coverage outside (0, 1).
        LimitExceededError: too many texts, negatives or templates, or one too long.
    """
    _check_texts(texts, "texts", "text")
    if negatives is not None:
        _check_texts(negatives, "negatives", "negatives")
    if templates is not None:
        _check_texts(templates, "templates", "templates")
        for template in templates:
            if template.count("{}") != 1:
                hint = 'Put exactly one "{}" where the name goes.'
                raise InvalidInputError(f"the template {template[:80]!r}", field="templates", hint=hint)
    return TextQuery(
        texts=tuple(texts),
        negatives=settings.negatives if negatives is None else tuple(negatives),
        templates=settings.templates if templates is None else tuple(templates),
        coverage=settings.coverage if coverage is None else check_coverage(coverage),
    )


def _check_texts(texts: Sequence[str], field: str, text_field: str) -> None:
    if isinstance(texts, str | bytes) or not isinstance(texts, Sequence) or not texts:
        raise InvalidInputError(f"{field} is not a list of strings", field=field, hint='Send ["mug"], not "mug".')
    if len(texts) > MAX_TEXTS:
        raise LimitExceededError(
            f"{len(texts)} {field}", field=field, limit=f"{MAX_TEXTS} {field}", hint="Ask in several requests."
        )
    for text in texts:
        _check_text(text, text_field)


def _check_text(text: str, field: str) -> None:
    if not isinstance(text, str):
        raise InvalidInputError(f"a text of type {type(text).__name__}", field=field, hint="Send a string.")
    if len(text) > _MAX_TEXT_CHARS:
        raise LimitExceededError(
            f"a text of {len(text)} characters",
            field=field,
            limit=f"{_MAX_TEXT_CHARS} characters",
            hint="Name the object in a few words.",
        )
    categories = {unicodedata.category(letter) for letter in text if letter not in "\t\n\r"}
    if categories & {"Cc", "Cs"}:
        raise InvalidInputError(
            "a text with control characters or lone surrogates", field=field, hint="Send printable Unicode."
        )
    if all(category[0] in "ZC" for category in categories):
        raise InvalidInputError("an empty text", field=field, hint="Say what to look for, e.g. 'mug'.")
