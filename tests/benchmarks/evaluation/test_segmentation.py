"""IoU against hand-made counts and a naive twin."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.evaluation.segmentation import mask_counts
from fastsplat_contract.errors import InvalidInputError
from tests.benchmarks.evaluation import naive


def test_a_perfect_map_scores_one_and_absent_labels_do_not_count() -> None:
    truth = np.array([[0, 1, 1], [2, 2, 0]])
    result = mask_counts(truth, truth, 4)
    assert result.macro_iou() == 1
    assert np.isnan(result.iou()[3:]).all()


def test_images_add_up_and_invalid_pixels_are_left_out() -> None:
    random = np.random.default_rng(0)
    truth, predicted = random.integers(0, 6, (2, 4, 9, 7))
    valid = random.random((9, 7)) < 0.7
    total = sum(
        (mask_counts(p, t, 5, valid) for p, t in zip(predicted, truth, strict=True)),
        mask_counts(predicted[0][:0], truth[0][:0], 5),
    )
    for label in range(6):
        a, b = predicted[:, valid] == label, truth[:, valid] == label
        assert total.iou()[label] == pytest.approx((a & b).sum() / (a | b).sum())


def test_maps_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="shape"):
        mask_counts(np.zeros((2, 3), int), np.zeros((3, 2), int), 1)
    with pytest.raises(InvalidInputError, match=r"0\.\.1"):
        mask_counts(np.full((2, 2), 2), np.zeros((2, 2), int), 1)


def test_micro_weighs_pixels_where_macro_weighs_labels() -> None:
    truth = np.array([[1] * 9 + [2]])
    predicted = np.array([[1] * 10])
    result = mask_counts(predicted, truth, 2)
    assert result.macro_iou() == pytest.approx((0.9 + 0) / 2)
    assert result.micro_iou() == pytest.approx(9 / 11)


@pytest.mark.parametrize("masked", [False, True])
def test_counts_are_those_of_the_confusion_table(masked: bool) -> None:
    random = np.random.default_rng(1)
    truth, predicted = random.integers(0, 6, (2, 9, 7))
    valid = random.random((9, 7)) < 0.7 if masked else None
    table = naive.confusion(predicted, truth, 5, valid)
    counts = mask_counts(predicted, truth, 5, valid).counts
    assert (counts == np.stack([np.diagonal(table), table.sum(axis=1), table.sum(axis=0)], axis=1)).all()


def test_very_many_labels_are_counted_without_a_table_of_pairs() -> None:
    truth, predicted = np.random.default_rng(1).integers(0, 6, (2, 9, 7))
    many = mask_counts(predicted, truth, 60_000)
    assert many.counts.shape == (60_001, 3) and many.macro_iou() == mask_counts(predicted, truth, 5).macro_iou()
