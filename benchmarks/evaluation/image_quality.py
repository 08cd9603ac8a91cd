"""PSNR and SSIM of rendered views, by torchmetrics: not by the code that the training loss is made of.

LPIPS is not among them: its distances need the ImageNet weights of AlexNet or VGG, which neither torchmetrics nor any
other package ships, and this project fetches no weights whose licence and digest are not in its model manifest.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torchmetrics.functional.image import peak_signal_noise_ratio, structural_similarity_index_measure

from benchmarks.evaluation.metrics import Skipped, ViewMetric, ViewPrediction, mean
from fastsplat.service.splatting.training.quality import color_corrected

_SIGMA = 1.5
_REACH = 5  # of SSIM's window of 11×11 pixels to each side
_NO_PIXEL = "no pixel of the view counts: its mask covers all of it"

Pixels = NDArray[np.floating]
"""[H, W, 3], 0..1."""


def psnr(image: Pixels, target: Pixels, valid: NDArray[np.bool_] | None = None) -> float | Skipped:
    """Peak signal-to-noise ratio in dB over the valid pixels [H, W]; skipped where there are none and where the images
    are equal, for then it is infinite."""
    counted = np.ones(target.shape[:2], np.bool_) if valid is None else valid
    if not counted.any():
        return Skipped(_NO_PIXEL)
    left, right = (torch.from_numpy(pixels[counted].astype(np.float64)) for pixels in (image, target))
    value = float(peak_signal_noise_ratio(left, right, data_range=1.0))
    return value if np.isfinite(value) else Skipped("image and photo are equal, so their PSNR is infinite")


def psnr_color_corrected(image: Pixels, target: Pixels, valid: NDArray[np.bool_] | None = None) -> float | Skipped:
    """As `psnr`, after the colors of the image were brought as close to the target's as an affine map can
    (`service.splatting.training.quality.color_corrected`)."""
    counted = None if valid is None else torch.tensor(valid)
    corrected = color_corrected(torch.tensor(image), torch.tensor(target), counted)
    return psnr(corrected.numpy(), target, valid)


def ssim(image: Pixels, target: Pixels, valid: NDArray[np.bool_] | None = None) -> float | Skipped:
    """Structural similarity (Wang et al. 2004) of RGB channels: the mean over windows centered on the valid pixels
    [H, W], with zeros outside the image, as 3DGS and its successors compute it in training and in their tables."""
    counted = np.ones(target.shape[:2], np.bool_) if valid is None else valid
    if not counted.any():
        return Skipped(_NO_PIXEL)
    margin = ((_REACH, _REACH), (_REACH, _REACH), (0, 0))
    full = _ssim_map(np.pad(image, margin), np.pad(target, margin))[_REACH:-_REACH, _REACH:-_REACH]
    return float(full[counted].mean(dtype=np.float64))


def _ssim_map(image: Pixels, target: Pixels) -> Pixels:
    """[H, W, 3]."""
    left, right = (
        torch.from_numpy(np.ascontiguousarray(pixels.transpose(2, 0, 1), np.float32))[None]
        for pixels in (image, target)
    )
    maps = structural_similarity_index_measure(left, right, sigma=_SIGMA, data_range=1.0, return_full_image=True)
    assert isinstance(maps, tuple)  # the mean and the map, as asked for
    return np.asarray(maps[1][0].permute(1, 2, 0).numpy())


def _of_view(
    quality: Callable[[Pixels, Pixels, NDArray[np.bool_] | None], float | Skipped],
) -> Callable[[ViewPrediction], float | Skipped]:
    """`quality` as a function of a view's rendered and true pixels."""

    def measure(view: ViewPrediction) -> float | Skipped:
        if view.rgb is None or view.truth.rgb is None:
            return Skipped("the view has no pose")
        return quality(view.rgb.astype(np.float32) / 255, view.truth.rgb.astype(np.float32) / 255, view.truth.valid)

    return measure


PSNR = ViewMetric(
    name="psnr",
    description="peak signal-to-noise ratio of the 8-bit rendered view over the pixels that count; mean over views",
    measure=_of_view(psnr),
    combine=mean,
)
PSNR_COLOR_CORRECTED = ViewMetric(
    name="psnr_cc",
    description="psnr after the view's colors were mapped by the affine map (3 x 4, least squares over pixels that "
    "count and are not saturated) that brings them closest to the photo's: for photos whose exposure and white balance "
    "a scene cannot know (as in RawNeRF, Mildenhall et al. 2022, and PPISP, Deutsch et al. 2026); mean over views",
    measure=_of_view(psnr_color_corrected),
    combine=mean,
)
SSIM = ViewMetric(
    name="ssim",
    description="structural similarity (Wang et al. 2004) of RGB: Gaussian window of 11×11 pixels, sigma 1.5, with "
    "zeros outside the image: the definition behind the tables of 3DGS and its successors; mean over views",
    measure=_of_view(ssim),
    combine=mean,
)
