"""How well answers of a draft foretell those of the finished scene."""

from __future__ import annotations

import pytest

from benchmarks.questions.drafts import agreement
from fastsplat_contract.queries import Answer, Outcome


def _answers(*said: tuple[Outcome, float | None]) -> list[Answer]:
    return [
        Answer("", "cup", "absent", "", likely, (), None, "score", None, "", 9, 0, (), (), outcome=outcome)
        for outcome, likely in said
    ]


def test_an_absence_is_turned_around_and_what_says_no_probability_is_not_judged() -> None:
    drafted = _answers(("not_here", 0.9), ("here", 0.8), ("probably_here", 0.2), ("cannot_say", None), ("here", None))
    final = _answers(("not_here", 0.6), ("probably_here", 0.7), ("not_here", 0.9), ("here", 0.9), ("here", 0.9))
    figures = agreement(drafted, final)
    assert figures["agree"] == pytest.approx(2 / 5) and figures["judged"] == 3 and figures["questions"] == 5
    assert figures["ece"] == pytest.approx((0.3 + 0.1 + 0.1) / 3)


def test_what_is_not_seen_says_nothing_of_being_here() -> None:
    assert agreement(_answers(("here", 0.9)), _answers(("not_seen", None)))["judged"] == 0
    assert agreement(_answers(("cannot_say", 0.9)), _answers(("here", 0.9)))["judged"] == 0


def test_probabilities_that_are_right_on_average_have_no_error() -> None:
    drafted = _answers(*[("probably_here", 0.75)] * 2)
    assert agreement(drafted, _answers(("here", 0.95), ("not_here", 0.45)))["ece"] == pytest.approx(0.0)
    assert agreement(drafted, _answers(("here", 0.95), ("here", 0.95)))["ece"] == pytest.approx(0.2)
    assert agreement(drafted, drafted) == {"agree": 1.0, "ece": 0.0, "questions": 2, "judged": 2}
