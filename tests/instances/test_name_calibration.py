"""What a detector's scores say of a name: a measured curve that never falls."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fastsplat.service.instances.name_calibration import name_curve, name_evidence, name_probability
from fastsplat.service.instances.naming import NAMED_FROM
from fastsplat.service.scene.types import STATED_FROM

_SCORES = st.lists(st.floats(0, 1), min_size=1, max_size=5)


def test_the_file_says_what_the_curve_was_measured_on() -> None:
    curve = name_curve()
    rows = (curve.evidence, curve.probability, curve.things, curve.right)
    assert len({len(row) for row in rows}) == 1 and curve.sets and curve.detector
    assert (np.diff(curve.evidence) > 0).all() and (np.diff(curve.probability) >= 0).all()
    assert all(0 <= right <= things for things, right in zip(curve.things, curve.right, strict=True))
    # Nothing is promised beyond what so many things can show: the rule of succession for all that had so much evidence.
    for place, probability in enumerate(curve.probability):
        things, right = sum(curve.things[place:]), sum(curve.right[place:])
        assert probability <= (right + 1) / (things + 2) + 1e-3
    assert curve.probability[0] < NAMED_FROM < curve.probability[-1]
    assert NAMED_FROM < STATED_FROM


@settings(max_examples=60)
@given(_SCORES)
def test_probabilities_are_such_and_nothing_is_likely_that_no_view_says(scores: list[float]) -> None:
    row = np.array([[0.0, *scores]])
    probability = name_probability(row)
    assert ((probability >= 0) & (probability <= 1)).all() and (probability[row == 0] == 0).all()


@settings(max_examples=60)
@given(_SCORES, st.floats(0, 1))
def test_a_second_name_makes_the_first_less_likely_and_a_higher_score_more(scores: list[float], other: float) -> None:
    alone = name_probability(np.array([[0.0, scores[0]]]))[0, 1]
    beside = name_probability(np.array([[0.0, scores[0], other]]))[0, 1]
    assert beside <= alone + 1e-12
    assert name_probability(np.array([[0.0, scores[0] / 2]]))[0, 1] <= alone + 1e-12


def test_the_evidence_of_one_name_alone_is_its_mean_score() -> None:
    np.testing.assert_allclose(
        name_evidence(np.array([[0.0, 0.6, 0.0], [0, 0, 0], [0, 0.4, 0.4]])), [[0, 0.6, 0], [0, 0, 0], [0, 0.2, 0.2]]
    )
    assert name_probability(np.array([[0.0, 1.0, 0.0]]))[0, 1] == pytest.approx(name_curve().probability[-1])
