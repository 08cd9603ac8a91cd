"""What can be asked, and what cannot."""

from __future__ import annotations

from typing import Any

import pytest

from fastsplat.service.query.language.words.query_text import TextQuery, check_query
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat_contract.errors import FastSplatError, InvalidInputError, LimitExceededError


@pytest.mark.parametrize(
    ("texts", "error"),
    [
        ([], InvalidInputError),
        ("mug", InvalidInputError),
        (b"mug", InvalidInputError),
        (None, InvalidInputError),
        ([""], InvalidInputError),
        (["  \t\n"], InvalidInputError),
        (["\u200b\u00a0"], InvalidInputError),
        (["mug", ""], InvalidInputError),
        (["mu\x00g"], InvalidInputError),
        (["mug\x1b[31m"], InvalidInputError),
        (["\ud800"], InvalidInputError),
        ([3], InvalidInputError),
        ([None], InvalidInputError),
        (["x" * 100_000], LimitExceededError),
        (["mug"] * 65, LimitExceededError),
    ],
)
def test_what_cannot_be_asked(texts: Any, error: type[FastSplatError]) -> None:
    with pytest.raises(error) as caught:
        check_query(texts, QuerySettings())
    assert caught.value.hint
    assert (error is LimitExceededError) == bool(caught.value.limit)


@pytest.mark.parametrize("text", ["🧸", "茶壶", "чайник", "إبريق", "x" * 1000, "a\tmug", "👨‍👩‍👧", "Ünïcödé"])
def test_what_can_be_asked(text: str) -> None:
    settings = QuerySettings()
    assert check_query([text], settings) == TextQuery(
        (text,), settings.negatives, settings.templates, settings.coverage
    )
