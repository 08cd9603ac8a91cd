"""Laws of bootstrap intervals."""

from __future__ import annotations

import numpy as np

from fastsplat.service.evaluation.bootstrap import bootstrap_interval


def test_an_interval_holds_the_figure_narrows_with_images_and_is_reproducible() -> None:
    random = np.random.default_rng(0)
    values = random.normal(5, 1, 200).tolist()
    few, many = (bootstrap_interval(values[:count], np.mean) for count in (10, 200))
    assert few[0] < np.mean(values[:10]) < few[1] and many[0] < np.mean(values) < many[1]
    assert many[1] - many[0] < few[1] - few[0]
    assert bootstrap_interval(values[:10], np.mean) == few
    assert bootstrap_interval([3.0] * 5, np.mean) == (3, 3)


def test_an_interval_needs_two_images_and_something_to_measure() -> None:
    assert bootstrap_interval([1.0], np.mean) is None
    assert bootstrap_interval([1.0, 2.0], lambda drawn: float("nan")) is None


def test_resamples_with_nothing_to_measure_are_left_out() -> None:
    def mean_of_the_known(drawn):
        known = [value for value in drawn if value is not None]
        return float(np.mean(known)) if known else float("nan")

    low, high = bootstrap_interval([None, 2.0, 4.0], mean_of_the_known)
    assert (low, high) == (2, 4)
    assert bootstrap_interval([None] * 9 + [2.0], mean_of_the_known) == (2, 2)
    assert bootstrap_interval([None] * 2, mean_of_the_known) is None
