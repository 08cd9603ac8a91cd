"""What calibrates an image-text model: log-likelihood ratios that say what pairs say, and no more."""

from __future__ import annotations

import numpy as np

from benchmarks.calibration.calibrate_looks import fitted, pairs_of
from fastsplat.service.query.phrases.thing_looks import ratios_of

_NAMES = ("cup", "book", "lamp", "shoe", "drum", "rope")


def _rooms(seed: int, noise: float) -> list[tuple[list[str], np.ndarray]]:
    """Rooms of five things whose looks are those of their names, more or less."""
    rng = np.random.default_rng(seed)
    rooms = []
    for _ in range(12):
        labels = rng.choice(_NAMES, 5, replace=False).tolist()
        looks = np.stack([np.eye(6)[_NAMES.index(label)] for label in labels]) + noise * rng.normal(size=(5, 6))
        rooms.append((labels, looks / np.linalg.norm(looks, axis=1, keepdims=True)))
    return rooms


_TEXTS = dict(zip(_NAMES, np.eye(6), strict=True))


def test_true_pairs_get_positive_ratios_and_others_negative_ones() -> None:
    calibration = fitted(pairs_of(_rooms(1, 0.3), _TEXTS), pairs_of(_rooms(2, 0.3), _TEXTS))
    assert calibration.figures["auroc"] > 0.95
    assert calibration.figures["brier"] < calibration.figures["brier_of_base_rate"] / 2
    ratios = ratios_of(np.array([0.9, 0.0, 0.05, -0.1, 0.0]), calibration.ratio)
    assert ratios[0] > 2 and (ratios[1:] < -1).all()


def test_a_model_whose_looks_say_nothing_gets_ratios_near_nothing() -> None:
    rng = np.random.default_rng(5)
    blind = [(labels, rng.permutation(looks)) for labels, looks in _rooms(3, 5.0)]
    calibration = fitted(pairs_of(blind, _TEXTS), pairs_of(_rooms(4, 5.0), _TEXTS))
    ratios = ratios_of(np.array([0.8, 0.1, 0.0, -0.2, 0.3]), calibration.ratio)
    assert np.abs(ratios).max() < 1.5
