"""The exposure that a scene is shown with whose photos differ in exposure.

The corrections have a mean of zero: what only the darker photos show below white would be burnt out. A finished scene
is therefore darkened as far as it has something to show.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from fastsplat.service.scene.artefact.scene import SH_C0, Gaussians
from fastsplat.service.splatting.exposure.photometric import SATURATED, channel_evs, correct, to_light
from fastsplat.service.splatting.gaussians import color_parameters, splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend, Rendering
from fastsplat.service.splatting.training_views import Frame, TrainingView, render_frame

_COVERED = 0.5
_BURNT_SHARE = 0.01
"""Of the pixels that photos show below white: how many the scene may show as white."""
_STOP = math.log(2) / 2.4
"""An EV of the light multiplies a stored value, offset by 0.055, by e to this (`photometric`)."""


@torch.no_grad()
def display_ev(
    parameters: Mapping[str, Tensor], views: Sequence[TrainingView], corrections: Tensor, backend: Backend
) -> float:
    """EV by which a scene of the photos' mean exposure must be darkened so that at most 1 % of what the photos show
    below white is white in it; 0 where it is so already.

    A pixel counts as bright as both the scene and the photo, of its own exposure, have it: so neither a photo whose
    correction is wrong nor a stray Gaussian darkens the scene, nor what is white in every photo.

    Args:
        parameters: colors of a finished scene, see `SplatState`; all harmonics are used.
        views: training views; they are compared at their smallest size.
        corrections: [V, 3] exposure, red, blue of each photo in EV (`photometric`).
    """
    samples = []
    degree, splats = math.isqrt(1 + parameters["sh_rest"].shape[1]) - 1, splats_of(parameters)
    for view, correction in zip(views, corrections, strict=True):
        frame, target = view.frames[0], view.frames[0].target()
        rendering = render_frame(parameters, splats, view, frame, degree=degree, backend=backend)
        both = torch.minimum(rendering.image, correct(target, -correction)).amax(dim=2)
        samples.append(both[_measured(rendering, target, frame)])
    values = torch.cat(samples)
    if not len(values):
        return 0.0
    brightest = values.kthvalue(max(1, math.ceil((1 - _BURNT_SHARE) * len(values)))).values
    return math.log2(min(1.0, 1.0 / max(float(to_light(brightest)), 1e-9)))


def exposed(gaussians: Gaussians, correction: Tensor) -> Gaussians:
    """The Gaussians as a photo of that exposure and white balance shows them.

    The constant part of the colors is corrected as light; what depends on the direction is multiplied as stored values
    above the toe of the curve of sRGB are (`service.splatting.exposure.photometric`).

    Args:
        correction: [3] exposure, red, blue in EV; zeros change nothing.
    """
    if not bool(correction.any()):
        return gaussians
    correction = correction.detach().cpu().double()
    base = torch.from_numpy(0.5 + SH_C0 * gaussians.sh[:, 0].astype(np.float64))
    constant = (correct(base, correction).numpy() - 0.5) / SH_C0
    sh = gaussians.sh * torch.exp(_STOP * channel_evs(correction)).numpy()
    sh[:, 0] = constant
    return replace(gaussians, sh=sh.astype(np.float32))


def scene_exposure(
    gaussians: Gaussians, views: Sequence[TrainingView], corrections: Tensor, backend: Backend
) -> tuple[Gaussians, float]:
    """A finished scene with the exposure that it is shown with, and the EV by which that is below the photos' mean."""
    ev = display_ev(color_parameters(gaussians, device_of(backend)), views, corrections, backend)
    return exposed(gaussians, torch.tensor([ev, 0.0, 0.0])), ev


def _measured(rendering: Rendering, target: Tensor, frame: Frame) -> Tensor:
    """bool [H, W]: pixels of the photo below white in every channel, of something that the scene has."""
    counts = (target < SATURATED).all(dim=2) & (rendering.alpha > _COVERED)
    return counts if frame.valid is None else counts & frame.valid
