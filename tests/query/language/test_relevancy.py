"""Laws of LERF's relevancy between texts."""

from __future__ import annotations

import numpy as np
import pytest

from fastsplat.service.query.language.meaning.relevancy import Scores, cosines, entries, relevancy_scores


def unit(count: int, seed: int, size: int = 12) -> np.ndarray:
    vectors = np.random.default_rng(seed).standard_normal((count, size))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


def score(labels: np.ndarray, queries: np.ndarray, negatives: np.ndarray, temperature: float) -> Scores:
    return relevancy_scores(cosines(queries, labels), entries(labels, negatives), temperature)


def test_it_is_the_smallest_pairwise_softmax() -> None:
    labels, queries, negatives, t = unit(7, 0), unit(3, 1), unit(4, 2), 10.0
    found = score(labels, queries, negatives, t)
    for q, query in enumerate(queries.astype(np.float64)):
        for n, label in enumerate(labels.astype(np.float64)):
            pairs = [
                np.exp(t * (label @ query)) / (np.exp(t * (label @ query)) + np.exp(t * (label @ negative)))
                for negative in negatives.astype(np.float64)
            ]
            assert found.relevancy[q, n] == pytest.approx(min(pairs), abs=1e-5)
            assert entries(labels, negatives).nearest_negative[n] == int(np.argmin(pairs))


@pytest.mark.parametrize("temperature", [0.0, 1e-9, 10.0, 1e6, 1e300])
def test_it_stays_a_probability_at_any_temperature(temperature: float) -> None:
    found = score(unit(50, 0), unit(20, 1), unit(4, 2), temperature)
    assert np.isfinite(found.relevancy).all()
    assert (found.relevancy >= 0).all() and (found.relevancy <= 1).all()
    if temperature == 0:
        assert (found.relevancy == 0.5).all()
    if temperature >= 1e6:
        np.testing.assert_array_equal(found.relevancy, (found.margin > 0).astype(float))


def test_no_entries() -> None:
    found = score(np.zeros((0, 12), dtype=np.float32), unit(3, 1), unit(4, 2), 10.0)
    assert found.relevancy.shape == (3, 0)
