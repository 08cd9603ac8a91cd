"""PSNR and SSIM against their definitions, written out, and what they skip."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from benchmarks.evaluation.image_quality import psnr, ssim
from benchmarks.evaluation.metrics import Skipped
from fastsplat.service.splatting.losses.functional import image_loss


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


def test_equal_images_have_an_ssim_of_one_and_no_psnr() -> None:
    black = np.zeros((12, 12, 3), np.float32)
    skipped = psnr(black, black)
    assert isinstance(skipped, Skipped) and "equal" in skipped.reason
    assert ssim(black, black) == 1


def test_what_cannot_be_measured_is_skipped_with_a_reason(pair) -> None:
    nothing = np.zeros(pair[0].shape[:2], bool)
    for quality in (psnr, ssim):
        skipped = quality(*pair, nothing)
        assert isinstance(skipped, Skipped) and "mask" in skipped.reason
