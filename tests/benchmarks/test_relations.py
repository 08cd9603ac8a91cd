"""Drawn questions about rooms whose layout is known: a few of those that the benchmark asks hundreds of."""

from __future__ import annotations

from benchmarks.relations.__main__ import answer_drawn, figures


def test_drawn_questions_are_answered_rightly_and_refused_rightly() -> None:
    scored = figures(answer_drawn(90, seed=40))
    assert scored["decided"]["questions"] >= 90 and scored["rightly_refused"]["questions"] >= 20
    assert scored["decided"]["right"] >= 0.95, scored
    assert scored["rightly_refused"]["right"] >= 0.95, scored
