"""How near renderings are to photos: PSNR, also color-corrected, and SSIM over valid pixels."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from fastsplat.service.splatting.exposure.photometric import corrected_for
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.losses.functional import image_loss
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.training_views import TrainingView, render_frame
from fastsplat_contract.errors import TrainingDivergedError

_SATURATED = 254.5 / 255
_MIN_FIT = 16
_JUDGED, _UNLIKE_DB = 8, 20.0


def psnr(image: Tensor, target: Tensor, valid: Tensor | None = None) -> float:
    """PSNR in dB of [H, W, 3] images, clamped to 0..1, over `valid` pixels; inf: equal; NaN: none."""
    error = (image.clamp(0, 1) - target) ** 2
    mse = float((error if valid is None else error[valid]).double().mean())
    return math.inf if mse == 0 else -10 * math.log10(mse)


def ssim(image: Tensor, target: Tensor, valid: Tensor | None = None) -> float:
    """Structural similarity (Wang et al. 2004) of [H, W, 3] images in 0..1, mean over `valid` pixels, NaN without any;
    windows as in the training loss (11×11, σ = 1.5, zeros outside)."""
    if valid is not None and not bool(valid.any()):
        return math.nan
    return 1 - float(image_loss(image.clamp(0, 1), target, 1.0, valid))


def color_corrected(image: Tensor, target: Tensor, valid: Tensor | None = None) -> Tensor:
    """The image [H, W, 3], 0..1, with its colors mapped by the affine map that brings them closest to the target's, as
    RawNeRF (Mildenhall et al., CVPR 2022) aligns colors: least squares over valid pixels without a saturated channel;
    the image as it is where these are fewer than 16."""
    clamped = image.clamp(0, 1).double()
    inside = ((clamped < _SATURATED) & (target < _SATURATED)).all(dim=2)
    if valid is not None:
        inside &= valid
    if int(inside.sum()) < _MIN_FIT:
        return image.clamp(0, 1)
    constant = clamped.new_ones(*clamped.shape[:2], 1)
    colors = torch.cat([clamped, constant], dim=2)
    rows = colors[inside]
    # A ridge of nearly nothing, so that a picture of one color has a solution too.
    gram = rows.T @ rows + 1e-9 * len(rows) * torch.eye(4, dtype=rows.dtype, device=rows.device)
    fit = torch.linalg.solve(gram, rows.T @ target[inside].double())
    corrected: Tensor = (colors @ fit).clamp(0, 1).to(image.dtype)
    return corrected


def mean_color(target: Tensor, valid: Tensor | None) -> Tensor:
    """A picture [H, W, 3] of the mean color of a photo's valid pixels."""
    return (target if valid is None else target[valid]).reshape(-1, 3).mean(dim=0).expand_as(target)


def require_likeness(
    parameters: Mapping[str, Tensor],
    views: Sequence[TrainingView],
    held_out: Sequence[TrainingView],
    corrections: Tensor | None,
    backend: Backend,
) -> None:
    """Refuses a scene most of whose pictures are below 20 dB and less like their photos than one color each is.

    Args:
        parameters: as for `measure_views`.
        views: training views; of these, and of `held_out` if photos are not corrected, at most 8 each are rendered.
        corrections: [V, 3] of the training views (`photometric`), or None.

    Raises:
        TrainingDivergedError: more than half of the pictures are that bad.
    """
    some = slice(None, None, math.ceil(len(views) / _JUDGED))
    judged, rows = [*views[some]], None if corrections is None else corrections.detach()[some]
    if rows is None and held_out:
        judged += held_out[:: math.ceil(len(held_out) / _JUDGED)]
    figures = []
    for row, image, target, valid in pictures(parameters, judged, backend):
        picture = image if rows is None else corrected_for(image, rows[row], target)
        figures.append((psnr(picture, target, valid), psnr(mean_color(target, valid), target, valid)))
    if 2 * sum(found < min(mean, _UNLIKE_DB) for found, mean in figures) > len(figures):
        found, mean = np.median(figures, axis=0)
        raise TrainingDivergedError(
            f"after the last step the scene's pictures have a PSNR of {found:.1f} dB",
            field="quality.psnr",
            limit=f"at least {min(mean, _UNLIKE_DB):.1f} dB, as one color for each photo has",
            hint="Check that poses belong to their photos, and leave out photos in which objects moved.",
        )


_FIGURES: Mapping[str, Callable[[Tensor, Tensor, Tensor | None], float]] = {
    "psnr": psnr,
    "psnr_cc": lambda image, target, valid: psnr(color_corrected(image, target, valid), target, valid),
    "ssim": ssim,
}


def measure_views(
    parameters: Mapping[str, Tensor], views: Sequence[TrainingView], backend: Backend, names: Iterable[str] = _FIGURES
) -> dict[str, float]:
    """psnr, psnr_cc (after `color_corrected`) and ssim of the scene's colors, or those of `names`: each the mean over
    the views where it is finite; absent if it is in none.

    All harmonics of the parameters are used (see `SplatState`), and views are compared at their largest size.
    """
    figures: dict[str, list[float]] = {name: [] for name in names}
    for _, image, target, valid in pictures(parameters, views, backend):
        for name, values in figures.items():
            values.append(_FIGURES[name](image, target, valid))
    finite = {name: [value for value in values if math.isfinite(value)] for name, values in figures.items()}
    return {name: float(np.mean(values)) for name, values in finite.items() if values}


@torch.no_grad()
def pictures(
    parameters: Mapping[str, Tensor], views: Sequence[TrainingView], backend: Backend
) -> Iterator[tuple[int, Tensor, Tensor, Tensor | None]]:
    """Row, picture [H, W, 3], photo and valid pixels (None: all) of each view that shows anything."""
    degree, splats = math.isqrt(1 + parameters["sh_rest"].shape[1]) - 1, splats_of(parameters)
    for row, view in enumerate(views):
        frame = view.frames[-1]
        if frame.has_content:
            image = render_frame(parameters, splats, view, frame, degree=degree, backend=backend).image
            yield row, image, frame.target(), frame.valid
