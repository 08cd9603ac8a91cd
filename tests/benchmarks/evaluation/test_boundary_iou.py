"""Laws of the boundary IoU, and the naive twin it must agree with."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.evaluation.boundary_iou import boundary_counts, boundary_region, boundary_width
from benchmarks.evaluation.segmentation import mask_counts, total
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


@pytest.mark.parametrize("seed", range(5))
def test_the_truth_has_perfect_boundaries(seed: int) -> None:
    truth = _blobs(seed)
    counts = boundary_counts(truth, truth, LABELS)
    assert counts.macro_iou() == 1 == counts.micro_iou()


def test_one_pixel_of_shift_costs_the_boundary_more_than_the_area() -> None:
    truth = np.zeros((120, 160), int)
    truth[30:90, 40:120] = 1
    shifted = np.roll(truth, 1, axis=1)
    plain = mask_counts(shifted, truth, 1).iou()[1]
    bounded = boundary_counts(shifted, truth, 1).iou()[1]
    assert bounded < plain < 1


def test_a_wider_region_than_the_thing_is_the_plain_iou() -> None:
    truth, predicted = _blobs(3), _noisy(_blobs(3), 3)
    wide = boundary_counts(predicted, truth, LABELS, diagonal_share=2.0)
    assert wide.iou() == pytest.approx(mask_counts(predicted, truth, LABELS).iou(), nan_ok=True)


def test_the_region_lies_in_the_mask_and_grows_with_its_width() -> None:
    mask = _blobs(1) == 2
    previous = np.zeros_like(mask)
    for width in range(1, 8):
        found = boundary_region(mask, width)
        assert not (found & ~mask).any() and not (previous & ~found).any()
        previous = found


def test_width_follows_the_diagonal_and_never_vanishes() -> None:
    assert boundary_width(360, 480, 0.02) == 12
    assert boundary_width(4, 4, 0.02) == 1


def test_a_missing_prediction_lowers_it() -> None:
    truths = [_blobs(seed) for seed in range(4)]
    found = [_noisy(truth, seed) for seed, truth in enumerate(truths)]

    def score(maps: list[np.ndarray]) -> float:
        return total([boundary_counts(*pair, LABELS) for pair in zip(maps, truths, strict=True)]).macro_iou()

    assert score([*found[:3], np.zeros_like(found[3])]) < score(found)
