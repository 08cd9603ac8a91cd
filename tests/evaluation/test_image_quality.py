"""PSNR and SSIM against their definitions, written out, and what they skip."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from fastsplat.service.evaluation.image_quality import psnr, ssim, ssim_zero_padded
from fastsplat.service.evaluation.types import Skipped
from fastsplat.service.splatting.losses.functional import image_loss


@pytest.fixture
def pair() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    target = random.random((17, 23, 3)).astype(np.float32)
    return np.clip(target + random.normal(0, 0.1, target.shape), 0, 1).astype(np.float32), target


def _ssim_at(image: np.ndarray, target: np.ndarray, row: int, column: int) -> float:
    """Wang et al. 2004, equation 13, of the window around one pixel, mean over channels, in float64."""
    offsets = np.arange(-5, 6)
    taps = np.exp(-0.5 * (offsets / 1.5) ** 2)
    weights = np.outer(taps, taps) / taps.sum() ** 2
    values = []
    for channel in range(3):
        x, y = (
            pixels[row - 5 : row + 6, column - 5 : column + 6, channel].astype(np.float64) for pixels in (image, target)
        )
        mean_x, mean_y = (weights * x).sum(), (weights * y).sum()
        var_x, var_y = (weights * (x - mean_x) ** 2).sum(), (weights * (y - mean_y) ** 2).sum()
        covariance = (weights * (x - mean_x) * (y - mean_y)).sum()
        c1, c2 = 0.01**2, 0.03**2
        top = (2 * mean_x * mean_y + c1) * (2 * covariance + c2)
        values.append(top / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2)))
    return float(np.mean(values))


def test_psnr_is_that_of_the_mean_squared_error_of_the_valid_pixels(pair) -> None:
    image, target = pair
    valid = np.random.default_rng(1).random(target.shape[:2]) < 0.4
    for mask, counted in ((None, np.ones(target.shape[:2], bool)), (valid, valid)):
        error = np.mean((image[counted].astype(np.float64) - target[counted]) ** 2)
        assert psnr(image, target, mask) == pytest.approx(-10 * math.log10(error), abs=1e-5)


def test_ssim_is_the_mean_over_windows_within_the_image_that_are_centered_on_valid_pixels(pair) -> None:
    image, target = pair
    valid = np.random.default_rng(1).random(target.shape[:2]) < 0.4
    for mask in (None, valid):
        centers = [
            (row, column) for row in range(5, 12) for column in range(5, 18) if mask is None or mask[row, column]
        ]
        expected = np.mean([_ssim_at(image, target, *center) for center in centers])
        assert ssim(image, target, mask) == pytest.approx(expected, abs=1e-5)


def test_zero_padded_ssim_is_what_training_minimizes_and_3dgs_reports(pair) -> None:
    image, target = pair
    valid = np.random.default_rng(1).random(target.shape[:2]) < 0.4
    for mask in (None, valid):
        tensors = (torch.from_numpy(pixels) for pixels in (image, target))
        loss = image_loss(*tensors, 1.0, None if mask is None else torch.from_numpy(mask))
        assert ssim_zero_padded(image, target, mask) == pytest.approx(1 - float(loss), abs=1e-5)


def test_equal_images_have_an_ssim_of_one_and_no_psnr() -> None:
    black = np.zeros((12, 12, 3), np.float32)
    skipped = psnr(black, black)
    assert isinstance(skipped, Skipped) and "equal" in skipped.reason
    assert ssim(black, black) == 1 == ssim_zero_padded(black, black)


def test_what_cannot_be_measured_is_skipped_with_a_reason(pair) -> None:
    nothing = np.zeros(pair[0].shape[:2], bool)
    for quality in (psnr, ssim, ssim_zero_padded):
        skipped = quality(*pair, nothing)
        assert isinstance(skipped, Skipped) and "mask" in skipped.reason
    small = np.full((10, 40, 3), 0.5, np.float32)
    skipped = ssim(small, small)
    assert isinstance(skipped, Skipped) and "11×11" in skipped.reason
    border = nothing.copy()
    border[0] = True  # valid pixels, none of which is the center of a window within the image
    assert isinstance(ssim(*pair, border), Skipped) and not isinstance(ssim_zero_padded(*pair, border), Skipped)
