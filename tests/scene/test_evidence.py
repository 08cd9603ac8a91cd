"""Evidence is a sum of integers: order does not matter, and what was added can be taken away to the bit."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.scene.artefact.scene import Evidence
from fastsplat.service.scene.objects.label_evidence import (
    UNIT,
    evidence_of,
    merged,
    no_evidence,
    posterior,
    rows_of,
    seen_pixels,
)
from fastsplat_contract.errors import InvalidInputError
from tests.scenes import evidence_from_dense

G, CLASSES = 7, 5


def drawn(seed: int, share: float = 0.4) -> Evidence:
    rng = np.random.default_rng(seed)
    return evidence_from_dense(rng.exponential(3.0, (G, CLASSES)) * (rng.random((G, CLASSES)) < share))


def same(a: Evidence, b: Evidence) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(Evidence))


def dense(evidence: Evidence) -> np.ndarray:
    table = np.zeros((len(evidence), CLASSES), np.int64)
    table[np.repeat(np.arange(len(evidence)), np.diff(evidence.starts)), evidence.labels] = evidence.counts
    return table


seeds = st.integers(0, 10_000)


@given(seeds, seeds, seeds)
def test_merging_is_a_sum_in_any_order_and_grouping(a: int, b: int, c: int) -> None:
    x, y, z = drawn(a), drawn(b), drawn(c)
    whole = merged([x, y, z, x])
    assert same(whole, merged([merged([z, x, x]), y]))
    np.testing.assert_array_equal(dense(whole), 2 * dense(x) + dense(y) + dense(z))


def test_evidence_of_other_gaussians_is_not_merged() -> None:
    with pytest.raises(InvalidInputError, match="7, 8"):
        merged([drawn(1), no_evidence(8)])
    with pytest.raises(InvalidInputError):
        merged([])


@given(seeds, st.lists(st.integers(0, G - 1), max_size=12))
def test_rows_follow_their_gaussians(seed: int, rows: list[int]) -> None:
    evidence = drawn(seed)
    chosen = rows_of(evidence, np.array(rows, np.int64))
    np.testing.assert_array_equal(dense(chosen), dense(evidence)[rows])


@given(seeds, st.floats(1e-3, 100))
def test_the_posterior_is_the_mean_of_the_dirichlet_distribution(seed: int, prior: float) -> None:
    evidence = drawn(seed)
    found = posterior(evidence, CLASSES, prior=prior)
    counts = dense(evidence) / UNIT
    expected = (counts + prior / CLASSES) / (counts.sum(1, keepdims=True) + prior)
    table = np.repeat(found.rest[:, None], CLASSES, axis=1)
    table[np.repeat(np.arange(G), np.diff(found.starts)), found.labels] = found.probability
    np.testing.assert_allclose(table, expected, rtol=1e-5)
    np.testing.assert_allclose(table.sum(1), 1, rtol=1e-5)
    seen = np.diff(evidence.starts) > 0
    np.testing.assert_allclose(
        found.confidence[seen], expected[seen][np.arange(seen.sum()), found.classes[seen]], rtol=1e-5
    )
    named = counts.max(1) > 0
    np.testing.assert_array_equal(found.classes[named], expected.argmax(1)[named])
    assert not found.classes[~seen].any() and not found.confidence[~seen].any()


def test_confidence_grows_with_what_was_seen_and_falls_with_contradiction() -> None:
    rows = np.arange(4)
    seen = evidence_of(rows, np.ones(4, int), np.array([1, 10, 100, 1000]) * UNIT, 4)
    assert (np.diff(posterior(seen, 3).confidence) > 0).all()
    against = merged([seen, evidence_of(rows, np.full(4, 2), np.full(4, 5 * UNIT), 4)])
    assert (posterior(against, 3).confidence < posterior(seen, 3).confidence)[1:].all()
    assert posterior(against, 3).classes.tolist() == [2, 1, 1, 1]


def test_views_that_contradict_each_other_evenly_give_the_lower_label_and_half_the_confidence() -> None:
    both = evidence_of(np.array([0, 0]), np.array([9, 4]), np.full(2, 1000 * UNIT), 1)
    found = posterior(both, 10)
    assert found.classes.tolist() == [4] and found.confidence[0] == pytest.approx(0.5, abs=1e-3)


def test_seen_pixels_are_the_blend_weight_of_all_classes() -> None:
    evidence = drawn(3)
    np.testing.assert_allclose(seen_pixels(evidence), dense(evidence).sum(1) / UNIT, rtol=1e-6)


def test_ten_thousand_labels_and_the_last_possible_one_have_room() -> None:
    labels = np.append(np.arange(1, 10_001), 65_535)
    evidence = evidence_of(np.zeros(len(labels), int), labels, np.full(len(labels), UNIT), 2)
    found = posterior(evidence, 65_536)
    assert evidence.labels[-1] == 65_535 and len(found.probability) == 10_001
    assert found.classes.tolist() == [1, 0] and found.confidence[1] == 0


def test_no_gaussians_have_no_evidence() -> None:
    found = posterior(evidence_from_dense(np.zeros((0, 3))), 3)
    assert len(found.classes) == 0 and len(merged([no_evidence(0)])) == 0
