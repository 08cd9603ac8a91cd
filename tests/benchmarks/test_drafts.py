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


def test_an_absence_is_turned_around_and_what_decides_nothing_is_not_judged() -> None:
    drafted = _answers(("not_here", 0.9), ("here", 0.8), ("probably_here", 0.2), ("cannot_say", None), ("here", None))
    final = _answers(("not_here", 0.6), ("probably_here", 0.7), ("not_here", 0.9), ("here", 0.9), ("here", 0.9))
    figures = agreement(drafted, final)
    assert figures["agree"] == pytest.approx(2 / 5) and figures["judged"] == 3 and figures["questions"] == 5
    assert figures["ece"] == pytest.approx((0.1 + 0.2 + 0.2) / 3)


def test_a_final_answer_that_is_less_likely_than_not_takes_nothing_to_be_here() -> None:
    drafted = _answers(("here", 0.9))
    assert agreement(drafted, _answers(("probably_here", 0.4)))["ece"] == pytest.approx(0.9)
    assert agreement(drafted, _answers(("not_here", 0.6)))["ece"] == pytest.approx(0.9)
    assert agreement(drafted, _answers(("here", None)))["ece"] == pytest.approx(0.1)
    assert agreement(drafted, _answers(("not_seen", None)))["judged"] == 0


def test_probabilities_that_come_true_as_often_as_they_say_have_no_error() -> None:
    drafted = _answers(*[("probably_here", 0.75)] * 4)
    assert agreement(drafted, _answers(*[("here", 0.9)] * 3, ("not_here", 0.9)))["ece"] == pytest.approx(0.0)
    assert agreement(drafted, drafted)["agree"] == 1.0
