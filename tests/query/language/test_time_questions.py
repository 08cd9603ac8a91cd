"""Questions about time, by what they ask, of what, and of which day."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest

from fastsplat.service.query.language.sentences.time_questions import parsed_day, time_question

_THURSDAY = datetime(2026, 11, 26, 9, 30, tzinfo=UTC)
_ALL = {"gone", "moved", "new", "changed"}


@pytest.mark.parametrize(
    ("text", "events"),
    [
        ("What moved?", {"moved"}),
        ("which objects have moved", {"moved"}),
        ("has anything been moved here?", {"moved"}),
        ("what is gone", {"gone", "changed"}),
        ("what is missing in this room?", {"gone", "changed"}),
        ("did anything change?", _ALL),
        ("what is new since yesterday?", {"new"}),
        ("what has changed since the flood", None),
        ("what is on the table", None),
        ("a moved house", None),
    ],
)
def test_which_events(text: str, events: set[str] | None) -> None:
    question = time_question(text, _THURSDAY)
    assert (question and (question.asks, set(question.events))) == (events and ("events", events))


@pytest.mark.parametrize(
    ("text", "asks", "about"),
    [
        ("Where was the mug on Monday?", "place", "the mug"),
        ("where were the red cups 3 days ago", "place", "the red cups"),
        ("where was the mug on the table", "", ""),
        ("where is the mug", "", ""),
        ("when was the mug last seen?", "last_seen", "the mug"),
        ("When did you last see the mug left of the lamp?", "last_seen", "the mug left of the lamp"),
        ("since when is the mug missing", "last_seen", "the mug"),
        ("has the mug moved", "last_seen", "the mug"),
        ("is the mug still there?", "last_seen", "the mug"),
        ("mug", "", ""),
    ],
)
def test_which_objects(text: str, asks: str, about: str) -> None:
    question = time_question(text, _THURSDAY)
    assert (asks, about) == ("", "") if question is None else (question.asks, question.about) == (asks, about)


@pytest.mark.parametrize(
    ("words", "day"),
    [
        ("today", (2026, 11, 26)),
        ("yesterday", (2026, 11, 25)),
        ("on monday", (2026, 11, 23)),
        ("thursday", (2026, 11, 26)),
        ("last thursday", (2026, 11, 19)),
        ("3 days ago", (2026, 11, 23)),
        ("a week ago", (2026, 11, 19)),
        ("2026-02-28", (2026, 2, 28)),
        ("23 november", (2026, 11, 23)),
        ("november 30", (2025, 11, 30)),
        ("3rd mar 2024", (2024, 3, 3)),
        ("2026-02-30", None),
        ("29 february", None),
        ("the table", None),
        ("99 days", None),
    ],
)
def test_which_day(words: str, day: tuple[int, int, int] | None) -> None:
    when = parsed_day(words, _THURSDAY)
    assert (when and (when.start, when.end - when.start)) == (day and (datetime(*day, tzinfo=UTC), timedelta(1)))


def test_last_week_has_seven_days() -> None:
    when = parsed_day("last week", _THURSDAY)
    assert when is not None
    assert (when.start, when.end - when.start) == (datetime(2026, 11, 16, tzinfo=UTC), timedelta(7))
