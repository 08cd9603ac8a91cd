"""IoU against hand-made counts and a naive twin."""

from __future__ import annotations

import numpy as np
import pytest

from fastsplat.service.evaluation import confusion
from fastsplat.service.evaluation.segmentation import mask_counts
from fastsplat_contract.errors import InvalidInputError


def test_a_perfect_map_scores_one_and_absent_labels_do_not_count() -> None:
    truth = np.array([[0, 1, 1], [2, 2, 0]])
    result = confusion(truth, truth, 4).masks()
    assert result.macro_iou() == 1 == result.accuracy()
    assert np.isnan(result.iou()[3:]).all()


def test_counts_follow_the_definition() -> None:
    truth = np.array([[1, 1, 1, 2]])
    predicted = np.array([[1, 1, 2, 2]])
    result = confusion(predicted, truth, 2).masks()
    assert result.iou()[1:] == pytest.approx([2 / 3, 1 / 2])
    assert result.macro_iou() == pytest.approx(7 / 12)
    assert result.accuracy() == pytest.approx(3 / 4)


def test_a_label_predicted_where_there_is_none_lowers_nothing_but_its_own_score() -> None:
    truth = np.array([[1, 1, 0, 0]])
    predicted = np.array([[1, 1, 2, 0]])
    result = confusion(predicted, truth, 2).masks()
    assert result.macro_iou() == 1
    assert result.iou()[2] == 0


def test_images_add_up_and_invalid_pixels_are_left_out() -> None:
    random = np.random.default_rng(0)
    truth, predicted = random.integers(0, 6, (2, 4, 9, 7))
    valid = random.random((9, 7)) < 0.7
    total = sum(
        (confusion(p, t, 5, valid) for p, t in zip(predicted, truth, strict=True)),
        confusion(predicted[0][:0], truth[0][:0], 5),
    )
    for label in range(6):
        a, b = predicted[:, valid] == label, truth[:, valid] == label
        assert total.masks().iou()[label] == pytest.approx((a & b).sum() / (a | b).sum())


def test_nothing_labelled_has_no_score() -> None:
    empty = confusion(np.zeros((2, 2), int), np.zeros((2, 2), int), 3).masks()
    assert np.isnan(empty.macro_iou()) and np.isnan(empty.accuracy())


def test_maps_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="shape"):
        confusion(np.zeros((2, 3), int), np.zeros((3, 2), int), 1)
    with pytest.raises(InvalidInputError, match=r"0\.\.1"):
        confusion(np.full((2, 2), 2), np.zeros((2, 2), int), 1)


def test_micro_weighs_pixels_where_macro_weighs_labels() -> None:
    truth = np.array([[1] * 9 + [2]])
    predicted = np.array([[1] * 10])
    result = confusion(predicted, truth, 2).masks()
    assert result.macro_iou() == pytest.approx((0.9 + 0) / 2)
    assert result.micro_iou() == pytest.approx(9 / 11)


def test_a_missing_prediction_counts_as_zero() -> None:
    truth = np.array([[1, 1, 2, 2]])
    whole = confusion(truth, truth, 2)
    both = (whole + confusion(np.zeros_like(truth), truth, 2)).masks()
    assert both.macro_iou() == 0.5 == both.micro_iou()


def test_masks_are_counted_alike_with_and_without_the_whole_table() -> None:
    random = np.random.default_rng(1)
    truth, predicted = random.integers(0, 6, (2, 9, 7))
    valid = random.random((9, 7)) < 0.7
    for mask in (None, valid):
        assert (
            mask_counts(predicted, truth, 5, mask).counts == confusion(predicted, truth, 5, mask).masks().counts
        ).all()
    many = mask_counts(predicted, truth, 60_000)
    assert many.counts.shape == (60_001, 3) and many.macro_iou() == mask_counts(predicted, truth, 5).macro_iou()
