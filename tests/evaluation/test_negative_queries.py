"""Laws of the questions for things that are not there, and of telling them from the others."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.evaluation.negative_queries import auroc, false_positive_rate_at, negative_nouns
from tests.evaluation import naive

FEW = st.lists(st.integers(0, 6).map(float), min_size=1, max_size=12)


def test_auroc_by_hand_in_float64() -> None:
    # Pairs of .9: 4 above of 4. Of .8: 3 above and .8 tied, 3.5. Of .3: above .1 alone, 1. Together 8.5 of 12.
    negative = [0.8, 0.7, 0.5, 0.1]
    assert auroc([0.9, 0.8, 0.3], negative) == 8.5 / 12
    # Scores that float32 cannot tell apart still have an order.
    assert auroc([0.5 + 1e-12], [0.5]) == 1 and auroc([0.5], [0.5 + 1e-12]) == 0
    assert auroc([0.25] * 3, [0.25] * 5) == 0.5


@given(positive=FEW, negative=FEW)
def test_auroc_is_the_share_of_ordered_pairs(positive: list[float], negative: list[float]) -> None:
    assert auroc(positive, negative) == pytest.approx(naive.auroc(positive, negative))
    assert auroc(positive, negative) + auroc(negative, positive) == pytest.approx(1)
    assert auroc(np.exp(positive), np.exp(negative)) == pytest.approx(auroc(positive, negative))


@given(positive=FEW, negative=FEW, recall=st.floats(0.05, 1))
def test_false_positives_at_a_recall_follow_the_threshold(
    positive: list[float], negative: list[float], recall: float
) -> None:
    possible = [t for t in positive if np.mean([p >= t for p in positive]) >= recall - 1e-9]
    assert false_positive_rate_at(recall, positive, negative) == np.mean([a >= max(possible) for a in negative])


def test_detection_without_a_side_has_no_figure() -> None:
    assert np.isnan(auroc([], [1.0])) and np.isnan(false_positive_rate_at(0.9, [1.0], []))


def test_negative_nouns_are_many_different_and_name_nothing_that_is_there() -> None:
    nouns = negative_nouns([])
    assert len(nouns) >= 150 and len(dictionary_of(nouns)) == len(nouns)
    both = (*nouns, *negative_nouns([], "household"))
    assert len(dictionary_of(both)) == len(both)
    left = negative_nouns(["Zebras", "toy car", "zebra crossing"])
    assert set(nouns) - set(left) == {"zebra", "race car"}
    table = ("table", "soda can", "cereal box", "frying pan", "utensil holder", "wall", "floor", "magnifying glass")
    assert len(negative_nouns(table)) >= 100
