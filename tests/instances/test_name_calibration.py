"""What a detector's scores say of a name: a measured model that never falls with them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fastsplat.service.instances.naming.naming import (
    NAMED_FROM,
    NameCategory,
    NameModel,
    name_evidence,
    name_model,
    name_probability,
)
from fastsplat.service.scene.artefact.scene import STATED_FROM

_DETECTOR = name_model().detector
_SCORES = st.lists(st.floats(0, 1), min_size=1, max_size=5)
_NAMES = st.sampled_from(["cup", "banana", "book", "what no detector says"])


def test_the_file_says_what_it_was_measured_on() -> None:
    model = name_model()
    assert model.sets and model.detector and model.factor > 0 and NAMED_FROM < STATED_FROM
    for category in model.categories.values():
        assert 0 <= category.right <= category.objects
    # Of two names that were seen as often the one that was right more often needs less evidence.
    seen = sorted(model.categories.values(), key=lambda category: category.objects)
    best = max(seen[-4:], key=lambda category: category.right / category.objects)
    worst = min(seen[-4:], key=lambda category: category.right / category.objects)
    assert best.offset > worst.offset


@settings(max_examples=60)
@given(_SCORES, _NAMES)
def test_probabilities_are_such_and_nothing_is_likely_that_no_view_says(scores: list[float], name: str) -> None:
    row = np.array([[0.0, *scores]])
    probability = name_probability(row, [name] * len(scores), _DETECTOR)
    assert ((probability >= 0) & (probability <= 1)).all() and (probability[row == 0] == 0).all()


@settings(max_examples=60)
@given(st.floats(0, 1), st.floats(0, 1), _NAMES)
def test_a_second_name_makes_the_first_less_likely_and_a_higher_score_more(
    score: float, rival_score: float, name: str
) -> None:
    alone = name_probability(np.array([[0.0, score]]), [name], _DETECTOR)[0, 1]
    beside = name_probability(np.array([[0.0, score, rival_score]]), [name, "another"], _DETECTOR)[0, 1]
    assert beside <= alone + 1e-12
    assert name_probability(np.array([[0.0, score / 2]]), [name], _DETECTOR)[0, 1] <= alone + 1e-12


def test_a_name_that_was_right_elsewhere_is_no_more_than_a_guess_without_evidence_of_its_own() -> None:
    likely = NameCategory(offset=9.0, objects=90, right=90)
    model = NameModel(detector="any", sets=("desk",), factor=1.0, offset=0.0, categories={"book": likely})
    little, much = model.probability(np.array([[0.59], [0.61]]), ["book"])[:, 0]
    assert NAMED_FROM <= little < STATED_FROM <= much
    doubtful = model.probability(np.array([[0.1], [0.59]]), ["cup"])[:, 0]
    np.testing.assert_allclose(doubtful, [0.1, 0.59])


def test_the_evidence_of_one_name_alone_is_its_mean_score() -> None:
    scores = np.array([[0.0, 0.6, 0.0], [0, 0, 0], [0, 0.4, 0.4]])
    np.testing.assert_allclose(name_evidence(scores), [[0, 0.6, 0], [0, 0, 0], [0, 0.2, 0.2]])
    first, nothing, twice = name_probability(scores, ["banana", "banana"], _DETECTOR)
    assert first[1] > twice[1] == pytest.approx(twice[2]) and not nothing.any()


@pytest.mark.parametrize("detector", ["", "picodet:mine", "grounding_dino_tiny"])
def test_what_was_measured_of_one_detector_says_nothing_of_another(detector: str) -> None:
    scores = np.array([[0.0, 1.0, 0.0], [0.0, 0.2, 0.0]])
    assert name_probability(scores, ["banana", "cup"], _DETECTOR)[0, 1] >= NAMED_FROM
    np.testing.assert_allclose(name_probability(scores, ["banana", "cup"], detector), [[0, 0.5, 0], [0, 0.2, 0]])
