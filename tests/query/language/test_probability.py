"""Laws of probabilities, of label sets, and of answers of an encoder with calibrated probabilities."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fastsplat.service.query.language.meaning.probability import (
    LEAD_LIMIT,
    Logistic,
    Nonconformities,
    ScoreCalibration,
    candidates,
    entry_probability,
    label_set,
    leads,
    nonconformity_bound,
    present_probability,
)
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from tests.query.conftest import make_scene
from tests.query.decisions import decided

CALIBRATION = ScoreCalibration(
    related=0.4,
    temperature=20.0,
    exact=0.9,
    entry=Logistic(score=15.0, lead=8.0, offset=-8.0),
    present=Logistic(score=29.0, offset=-12.5),
    background=0.33,
    scenes=Nonconformities(),
)
scores = arrays(np.float64, st.integers(1, 30), elements=st.floats(-1, 1))


@given(scores)
def test_probabilities_keep_the_order_of_the_scores_and_something_is_here_as_likely(values: np.ndarray) -> None:
    entry = entry_probability(values, CALIBRATION)
    assert ((entry >= 0) & (entry <= 1)).all()
    assert (np.diff(entry[values.argsort()]) >= -1e-12).all()
    assert entry.max() <= float(present_probability(values, entry, CALIBRATION)) <= 1


def test_nothing_is_in_an_empty_dictionary() -> None:
    none = np.zeros((3, 0))
    entry = entry_probability(none, CALIBRATION)
    np.testing.assert_array_equal(present_probability(none, entry, CALIBRATION), np.zeros(3))
    assert label_set(candidates(entry[0], 0.0), (0.1, 0.1)) == (0,)


def test_a_lead_is_over_the_best_of_the_others() -> None:
    found = np.array([0.5, 0.7, 0.6])
    np.testing.assert_allclose(leads(found, 0.0), [-0.2, 0.1, -0.1])
    np.testing.assert_allclose(leads(found, 0.65), [-0.2, 0.05, -0.1])
    np.testing.assert_allclose(leads(np.array([0.5]), 0.4), [0.1])
    np.testing.assert_allclose(leads(np.array([0.7, 0.7]), 0.0), [0, 0])
    assert np.abs(leads(np.array([-1.0, 1.0]), 0.0)).max() == LEAD_LIMIT
    np.testing.assert_allclose(leads(np.stack([found, found[::-1]]), 0.0)[1], leads(found, 0.0)[::-1])


def test_a_rival_makes_the_leading_entry_less_likely() -> None:
    alone, beside = np.array([0.6, 0.2]), np.array([0.6, 0.58])
    assert entry_probability(alone, CALIBRATION)[0] > entry_probability(beside, CALIBRATION)[0] + 0.1


@pytest.mark.parametrize("coverage", [0.5, 0.8, 0.9, 0.95])
def test_bounds_cover_questions_to_new_scenes(coverage: float) -> None:
    """Scenes differ, and have different numbers of questions: these are not exchangeable."""
    rng = np.random.default_rng(int(100 * coverage))
    trials, hits = 2000, 0
    for _ in range(trials):
        hardness = rng.beta(0.5, 1.5, 26)
        sizes = rng.integers(1, 20, 26)
        drawn = [np.clip(hard + rng.normal(0, 0.1, size), 0, 1) for hard, size in zip(hardness, sizes, strict=True)]
        bound = nonconformity_bound(tuple(tuple(scene.tolist()) for scene in drawn[:-1]), coverage)
        hits += bool(drawn[-1][0] <= bound)
    deviation = np.sqrt(coverage * (1 - coverage) / trials)
    assert hits / trials >= coverage - 4 * deviation
    assert hits / trials <= coverage + 2 / 26 + 4 * deviation


def test_more_than_the_scenes_can_promise_is_everything() -> None:
    scenes = tuple((0.1, 0.2) for _ in range(9))
    assert nonconformity_bound(scenes, 0.9) == 0.2
    assert nonconformity_bound(scenes, 0.91) == np.inf
    assert nonconformity_bound((), 0.5) == np.inf
    values = np.linspace(0, 1, 8)
    assert label_set(values, (np.inf, np.inf)) == tuple(range(8))
    assert nonconformity_bound(scenes, 0.0) == -np.inf


bounds = st.tuples(st.floats(0, 1), st.floats(0, 1))


@given(arrays(np.float64, st.integers(1, 30), elements=st.floats(0, 1)), bounds, bounds)
def test_sets_grow_with_the_bounds_and_never_vanish(
    values: np.ndarray, first: tuple[float, float], second: tuple[float, float]
) -> None:
    small = label_set(values, (min(first[0], second[0]), min(first[1], second[1])))
    large = label_set(values, (max(first[0], second[0]), max(first[1], second[1])))
    assert small and set(small) <= set(large) and large[0] == small[0]
    assert values[small[0]] == values.min()
    assert (np.diff(values[list(large)]) >= 0).all()


def test_what_is_there_and_what_is_not_have_bounds_of_their_own() -> None:
    """A common bound would cover both together, and one of them too seldom."""
    scenes = Nonconformities(present=((0.6,),) * 9, absent=((0.1,),) * 9)
    assert scenes.bounds(0.9) == (0.1, 0.6)
    assert label_set(np.array([0.3, 0.5, 0.7]), scenes.bounds(0.9)) == (0, 1)  # 0 as the likeliest
    assert label_set(np.array([0.5, 0.3, 0.55]), scenes.bounds(0.9)) == (1, 2)


def test_scenes_weigh_the_same_whatever_they_were_asked() -> None:
    scenes = ((0.1,), (0.2,), (0.9,) * 50)
    assert nonconformity_bound(scenes, 0.5) == 0.2
    assert nonconformity_bound(scenes, 0.75) == 0.9


@pytest.mark.parametrize(
    ("count", "temperature"), [(0, None), (1, None), (2, None), (2, 0.0), (2, 1e6), (10_000, None)]
)
def test_calibrated_answers_of_any_dictionary_are_whole(
    calibrated_encoder: Any, count: int, temperature: float | None
) -> None:
    settings = QuerySettings(temperature=temperature)
    index = SceneIndex(make_scene([f"object {i}x" for i in range(count)], code=2), calibrated_encoder, settings)
    assert index.calibrated
    for text in ("茶壶", "🧸", "object", "object 0x", "where?"):
        ranked = [decided(index, text, coverage=coverage)[0] for coverage in (1e-9, 0.5, 0.9, 1 - 1e-9)]
        sets, verdict = [decision.answer for decision in ranked], ranked[0].verdict
        for answer in sets:
            named = count > 0 and text == "object 0x"
            assert len(answer.matches) == count and ranked[0].named == named
            assert 0 <= answer.presence <= 1
            assert (answer.probability is None) == (verdict == "undecided")
            assert answer.probability is None or 0.5 <= answer.probability <= 1 or verdict == "related"
            assert answer.presence >= max((match.probability for match in answer.matches), default=0)
            if verdict == "absent":
                assert answer.probability == pytest.approx(1 - answer.presence)
            assert answer.label_set and set(answer.label_set) <= set(range(count + 1))
            assert all(0 <= match.probability <= 1 and 0 <= match.relevancy <= 1 for match in answer.matches)
            if named:
                assert answer.label_set == (1,) and answer.probability == 1
        sizes = [len(answer.label_set) for answer in sets]
        assert sizes == sorted(sizes) and sizes[0] == 1 and (sizes[-1] == count + 1 or ranked[0].named)
        assert {(decision.verdict, decision.answer.matches) for decision in ranked} == {(verdict, sets[0].matches)}
        if not count:
            assert verdict == ("undecided" if text in ("茶壶", "🧸", "where?") else "absent")
            assert sets[0].presence == 0 and sets[-1].label_set == (0,)
