"""Prunes Gaussians and harmonics that held-out views hardly need."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.raster.rendering import accumulate_weights
from fastsplat.service.splatting.state import GAUSSIAN_PARAMETERS
from fastsplat_contract.geometry.camera import Camera

MAX_EVAL_VIEWS = 8  # held-out views used for measurement
_HALVINGS = 6

MeasurePsnr = Callable[[Mapping[str, Tensor]], float]
"""Measures parameters on views, PSNR in dB."""


@torch.no_grad()
def max_contribution(
    parameters: Mapping[str, Tensor], views: Iterable[tuple[Tensor, Camera]], backend: Backend = "cpu"
) -> NDArray[np.float64]:
    """Returns the pixels each Gaussian fills in its best view, [G].

    Not the sum over views, which would first prune what few views show.
    """
    device = parameters["means"].device
    splats = splats_of(parameters, torch.zeros(len(parameters["means"]), 1, device=device))
    most = np.zeros(len(splats.means))
    for viewmat, camera in views:
        pixels = torch.ones(camera.height, camera.width, 1, device=device)
        filled = accumulate_weights(splats, viewmat.to(device), camera, pixels, backend=backend)[:, 0]
        most = np.maximum(most, filled.double().cpu().numpy())
    return most


def required_rows(
    parameters: Mapping[str, Tensor], contribution: NDArray[np.float64], measure: MeasurePsnr, least_db: float
) -> Tensor:
    """Rows of the Gaussians without which PSNR falls below `least_db`, ascending, int64 [K].

    Those of smallest contribution go, as many as that permits (in steps of 1/64).
    """
    order = np.argsort(contribution, kind="stable")

    def rows_at(share: float) -> Tensor:
        return torch.from_numpy(np.sort(order[int(share * len(order)) :])).to(parameters["means"].device)

    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        share, rows = (low + high) / 2, rows_at((low + high) / 2)
        fewer = {name: value[rows] if name in GAUSSIAN_PARAMETERS else value for name, value in parameters.items()}
        low, high = (share, high) if measure(fewer) >= least_db else (low, share)
    return rows_at(low)


def required_degree(parameters: Mapping[str, Tensor], measure: MeasurePsnr, least_db: float) -> int:
    """Lowest degree of the harmonics for which PSNR is not below `least_db`."""
    harmonics = parameters["sh_rest"]
    highest = math.isqrt(1 + harmonics.shape[1]) - 1
    for degree in range(highest):
        if measure({**parameters, "sh_rest": harmonics[:, : (degree + 1) ** 2 - 1]}) >= least_db:
            return degree
    return highest
