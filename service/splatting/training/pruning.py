"""Prunes Gaussians and harmonics that held-out views hardly need."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.raster.rendering import accumulate_weights
from fastsplat_contract.geometry.camera import Camera

MAX_EVAL_VIEWS = 8  # held-out views used for measurement

_HALVINGS = 6
EVALUATIONS = _HALVINGS + 4
"""Approximate number of measurements by `prune_to_psnr`."""

MeasurePsnr = Callable[[Gaussians], float]
"""Measures PSNR on held-out views, dB."""


@torch.no_grad()
def max_contribution(
    gaussians: Gaussians, views: Iterable[tuple[Tensor, Camera]], backend: Backend = "cpu"
) -> NDArray[np.float64]:
    """Returns the pixels each Gaussian fills in its best view, [G].

    Not the sum over views, which would first prune what few views show.
    """
    device = device_of(backend)
    splats = splats_of(gaussians, torch.zeros(len(gaussians), 1, device=device), device)
    most = np.zeros(len(gaussians))
    for viewmat, camera in views:
        unit_image = torch.ones(camera.height, camera.width, 1, device=device)
        filled = accumulate_weights(splats, viewmat.to(device), camera, unit_image, backend=backend)[:, 0]
        most = np.maximum(most, filled.double().cpu().numpy())
    return most


def prune_to_psnr(
    gaussians: Gaussians, contribution: NDArray[np.float64], measure: MeasurePsnr, max_drop_db: float
) -> Gaussians:
    """Removes harmonics and Gaussians for at most `max_drop_db` of PSNR.

    Harmonics go first, highest degrees together, for up to half of the allowance; then the Gaussians of smallest
    contribution, as many as the allowance permits (in steps of 1/64). Nothing goes if PSNR is not finite.
    """
    if max_drop_db <= 0 or not len(gaussians):
        return gaussians
    whole = measure(gaussians)
    if not math.isfinite(whole):
        return gaussians
    flattest = gaussians
    for degree in range(gaussians.sh_degree):
        flatter = replace(gaussians, sh=np.ascontiguousarray(gaussians.sh[:, : (degree + 1) ** 2]))
        if measure(flatter) >= whole - max_drop_db / 2:
            flattest = flatter
            break
    order = np.argsort(contribution, kind="stable")
    best = flattest
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        share = (low + high) / 2
        fewer = _rows_of(flattest, np.sort(order[int(share * len(order)) :]))
        if measure(fewer) >= whole - max_drop_db:
            low, best = share, fewer
        else:
            high = share
    return best


def _rows_of(gaussians: Gaussians, rows: NDArray[np.int64]) -> Gaussians:
    return Gaussians(**{name: np.ascontiguousarray(array[rows]) for name, array in vars(gaussians).items()})
