"""How near renderings are to photos: PSNR, also after a correction of the colors, and SSIM over valid pixels, of one
image and over views."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.losses.functional import image_loss
from fastsplat.service.splatting.objective import render_frame
from fastsplat.service.splatting.raster.types import Backend
from fastsplat.service.splatting.training_views import TrainingView

_SATURATED = 254.5 / 255
_MIN_FIT = 16


def psnr(image: Tensor, target: Tensor, valid: Tensor | None = None) -> float:
    """Peak signal-to-noise ratio in dB of [H, W, 3] images in 0..1 over `valid` pixels [H, W].

    The image is clamped to 0..1 first. inf when equal, NaN when no pixel is valid.
    """
    error = (image.clamp(0, 1) - target) ** 2
    mse = float((error if valid is None else error[valid]).double().mean())
    return math.inf if mse == 0 else -10 * math.log10(mse)


def ssim(image: Tensor, target: Tensor, valid: Tensor | None = None) -> float:
    """Structural similarity (Wang et al. 2004) of [H, W, 3] images in 0..1, mean over `valid` pixels [H, W].

    Window and padding are those of the training loss (and of 3DGS): 11×11, σ = 1.5, zeros outside. NaN when no pixel
    is valid.
    """
    if valid is not None and not bool(valid.any()):
        return math.nan
    return 1 - float(image_loss(image.clamp(0, 1), target, 1.0, valid))


def color_corrected(image: Tensor, target: Tensor, valid: Tensor | None = None) -> Tensor:
    """The image [H, W, 3], 0..1, with its colors mapped by the affine map that brings them closest to the target's.

    What a picture is worth whose exposure and white balance cannot be known from elsewhere: as RawNeRF (Mildenhall et
    al., "NeRF in the Dark", CVPR 2022) and PPISP (Deutsch et al., CVPR 2026) align colors before they compare. A
    least-squares fit in float64 of three numbers from three and a constant, over the valid pixels in which neither has
    a channel that is saturated; the image as it is where these are fewer than 16.
    """
    clamped = image.clamp(0, 1).double()
    inside = ((clamped < _SATURATED) & (target < _SATURATED)).all(dim=2)
    if valid is not None:
        inside &= valid
    if int(inside.sum()) < _MIN_FIT:
        return image.clamp(0, 1)
    ones = clamped.new_ones(*clamped.shape[:2], 1)
    colors = torch.cat([clamped, ones], dim=2)
    rows = colors[inside]
    # A ridge of nearly nothing, so that a picture of one color has a solution too.
    gram = rows.T @ rows + 1e-9 * len(rows) * torch.eye(4, dtype=rows.dtype, device=rows.device)
    fit = torch.linalg.solve(gram, rows.T @ target[inside].double())
    corrected: Tensor = (colors @ fit).clamp(0, 1).to(image.dtype)
    return corrected


@torch.no_grad()
def measure_views(
    parameters: Mapping[str, Tensor], views: Sequence[TrainingView], backend: Backend
) -> dict[str, float]:
    """psnr, psnr_cc and ssim of the scene's colors, each the mean over the views where it is finite; absent if it
    is in none.

    A view without a valid pixel has no figure, and one that is reproduced exactly (a black photo of nothing) has no
    finite PSNR. psnr_cc is the PSNR after `color_corrected`.

    Args:
        parameters: see `SplatState`; all harmonics are used.
        views: compared at their largest size.
    """
    degree = math.isqrt(1 + parameters["sh_rest"].shape[1]) - 1
    splats = splats_of(parameters)
    figures: dict[str, list[float]] = {"psnr": [], "psnr_cc": [], "ssim": []}
    for view in views:
        frame = view.frames[-1]
        if not frame.has_content:
            continue
        image = render_frame(parameters, splats, view, frame, degree=degree, backend=backend).image
        target = frame.target()
        figures["psnr"].append(psnr(image, target, frame.valid))
        figures["psnr_cc"].append(psnr(color_corrected(image, target, frame.valid), target, frame.valid))
        figures["ssim"].append(ssim(image, target, frame.valid))
    finite = {name: [value for value in values if math.isfinite(value)] for name, values in figures.items()}
    return {name: float(np.mean(values)) for name, values in finite.items() if values}
