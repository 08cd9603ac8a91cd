"""Laws of the boundary IoU, and the naive twin it must agree with."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.evaluation.boundary_iou import boundary_counts, boundary_width
from benchmarks.evaluation.segmentation import mask_counts
from tests.benchmarks.evaluation import naive

LABELS = 4


def _blobs(seed: int, shape: tuple[int, int] = (23, 31)) -> np.ndarray:
    """A map of a few connected regions, as label maps are."""
    random = np.random.default_rng(seed)
    coarse = random.integers(0, LABELS + 1, (4, 5)).astype(np.uint8)
    return cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_NEAREST).astype(np.int64)


def _noisy(truth: np.ndarray, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed + 1000)
    wrong = random.random(truth.shape) < 0.1
    return np.where(wrong, random.integers(0, LABELS + 1, truth.shape), truth)


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000), share=st.sampled_from([0.02, 0.05, 0.1]))
def test_boundary_counts_agree_with_the_pixel_loop(seed: int, share: float) -> None:
    truth = _blobs(seed)
    predicted = _noisy(truth, seed)
    width = boundary_width(*truth.shape, share)
    scores = boundary_counts(predicted, truth, LABELS, diagonal_share=share).iou()
    for label in range(LABELS + 1):
        expected = naive.iou(naive.region(predicted == label, width), naive.region(truth == label, width))
        assert scores[label] == pytest.approx(expected, nan_ok=True)


def test_one_pixel_of_shift_costs_the_boundary_more_than_the_area() -> None:
    truth = np.zeros((120, 160), int)
    truth[30:90, 40:120] = 1
    shifted = np.roll(truth, 1, axis=1)
    plain = mask_counts(shifted, truth, 1).iou()[1]
    bounded = boundary_counts(shifted, truth, 1).iou()[1]
    assert bounded < plain < 1


def test_width_follows_the_diagonal_and_never_vanishes() -> None:
    assert boundary_width(360, 480, 0.02) == 12
    assert boundary_width(4, 4, 0.02) == 1
