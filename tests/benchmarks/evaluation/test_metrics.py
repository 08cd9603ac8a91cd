"""Metrics against hand-made counts, their definitions written out, and other libraries."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_erosion

from benchmarks.evaluation.boundary_iou import boundary_counts, boundary_width
from benchmarks.evaluation.depth_error import depth_error
from benchmarks.evaluation.image_quality import psnr, ssim
from benchmarks.evaluation.localization import box_of, peak, peak_in_box
from benchmarks.evaluation.mask3d_iou import NO_TRUTH, TrueSurface, gaussian_truth, mask3d_counts
from benchmarks.evaluation.metrics import Skipped
from benchmarks.evaluation.segmentation import mask_counts
from fastsplat.service.splatting.losses.functional import image_loss
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera, PosedCamera


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
def test_boundary_counts_are_those_of_what_an_erosion_takes_away(seed: int, share: float) -> None:
    truth = _blobs(seed)
    predicted = _noisy(truth, seed)
    square = np.ones((2 * boundary_width(*truth.shape, share) + 1,) * 2)
    counts = boundary_counts(predicted, truth, LABELS, diagonal_share=share).counts
    for label in range(LABELS + 1):
        true, guess = (mask & ~binary_erosion(mask, square) for mask in (truth == label, predicted == label))
        assert counts[label].tolist() == [(true & guess).sum(), true.sum(), guess.sum()]


def test_width_follows_the_diagonal_and_never_vanishes() -> None:
    assert boundary_width(360, 480, 0.02) == 12
    assert boundary_width(4, 4, 0.02) == 1


@pytest.fixture
def pair() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    target = random.random((17, 23, 3)).astype(np.float32)
    return np.clip(target + random.normal(0, 0.1, target.shape), 0, 1).astype(np.float32), target


def test_psnr_is_that_of_the_mean_squared_error_of_the_valid_pixels(pair) -> None:
    image, target = pair
    valid = np.random.default_rng(1).random(target.shape[:2]) < 0.4
    for mask, counted in ((None, np.ones(target.shape[:2], bool)), (valid, valid)):
        error = np.mean((image[counted].astype(np.float64) - target[counted]) ** 2)
        assert psnr(image, target, mask) == pytest.approx(-10 * math.log10(error), abs=1e-5)


def test_ssim_is_what_training_minimizes_and_3dgs_reports(pair) -> None:
    image, target = pair
    valid = np.random.default_rng(1).random(target.shape[:2]) < 0.4
    for mask in (None, valid):
        tensors = (torch.from_numpy(pixels) for pixels in (image, target))
        loss = image_loss(*tensors, 1.0, None if mask is None else torch.from_numpy(mask))
        assert ssim(image, target, mask) == pytest.approx(1 - float(loss), abs=1e-5)


def test_what_cannot_be_measured_is_skipped_with_a_reason(pair) -> None:
    nothing = np.zeros(pair[0].shape[:2], bool)
    for quality in (psnr, ssim):
        skipped = quality(*pair, nothing)
        assert isinstance(skipped, Skipped) and "mask" in skipped.reason


def test_a_ring_has_its_peak_in_the_box() -> None:
    ring = np.zeros((21, 21), bool)
    ring[3:18, 3:18] = True
    ring[6:15, 6:15] = False
    relevancy = np.zeros((21, 21), np.float32)
    relevancy[10, 10] = 1
    assert box_of(ring) == (3, 3, 18, 18)
    assert peak_in_box(relevancy, [box_of(ring)])


def test_a_plateau_peaks_at_its_depth_not_at_its_first_pixel() -> None:
    flat = np.zeros((30, 30), np.float32)
    flat[5:25, 5:25] = 1
    row, column = peak(flat)
    assert 13 <= row <= 16 and 13 <= column <= 16
    flat[1, 1] = 1
    assert peak(flat) == (row, column)


def test_one_of_several_boxes_is_enough() -> None:
    relevancy = np.zeros((10, 10))
    relevancy[8, 8] = 1
    assert peak_in_box(relevancy, [(0, 0, 2, 2), (8, 8, 9, 9)])
    assert not peak_in_box(relevancy, [(0, 0, 2, 2), (8.6, 8, 9, 9)])
    assert not peak_in_box(relevancy, [])


def test_missing_depth_counts_as_all_wrong_and_unknown_truth_not_at_all() -> None:
    truth = np.full((2, 2), 2.0)
    half = truth.copy()
    half[0] = 0
    assert depth_error(half, truth) == 0.5
    assert depth_error(truth, half) == 0
    assert depth_error(half, truth, np.array([[False, False], [True, True]])) == 0
    assert depth_error(truth, np.zeros((2, 2))) is None
    with pytest.raises(InvalidInputError, match="shape"):
        depth_error(truth, np.ones((3, 2)))


def test_centres_on_the_true_surface_get_its_label_and_others_none() -> None:
    camera = Camera(40, 20, 30, 30, 20, 10)
    pose = np.eye(4)
    pose[0, 3] = 1.5
    labels = np.ones((20, 40), int)
    labels[:, 20:] = 2
    surfaces = [TrueSurface(PosedCamera(camera, at), np.full((20, 40), 2.0), labels) for at in (np.eye(4),)]
    means = np.array([[-0.5, 0, 2], [0.5, 0, 2.03], [0.5, 0, 2.5], [0, 0, -2], [9, 0, 2]])
    truth = gaussian_truth(means, surfaces, 2)
    assert truth.tolist() == [1, 2, NO_TRUTH, NO_TRUTH, NO_TRUTH]
    moved = [TrueSurface(PosedCamera(camera, pose), np.full((20, 40), 2.0), labels)]
    assert gaussian_truth(means + np.array([1.5, 0, 0]), moved, 2).tolist() == truth.tolist()
    result = mask3d_counts(np.array([1, 1, 2, 2, 2]), truth, 2)
    assert result.iou()[1:] == pytest.approx([0.5, 0])
    assert mask3d_counts(np.array([1, 2, 0, 0, 0]), truth, 2).macro_iou() == 1


def test_views_vote_about_a_gaussian() -> None:
    posed = PosedCamera(Camera(4, 4, 4, 4, 2, 2), np.eye(4))
    views = [TrueSurface(posed, np.ones((4, 4)), np.full((4, 4), label)) for label in (2, 1, 2)]
    assert gaussian_truth(np.array([[0, 0, 1.0]]), views, 2).tolist() == [2]
    assert gaussian_truth(np.array([[0, 0, 1.0]]), views[:2], 2).tolist() == [1]  # a tie
    assert gaussian_truth(np.zeros((0, 3)), views, 2).tolist() == []
