"""Only what the scene requires: what a trained scene can do without, found out on views that it never saw."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.scene.types import Gaussians
from fastsplat.service.splatting.raster import Backend, Splats, blend_sums, device_of
from fastsplat.service.splatting.views import TrainingView

JUDGES = 8
"""Held-out views that judge, at most."""

_HALVINGS = 6
MEASURES = _HALVINGS + 4
"""How often they are drawn, about."""

Quality = Callable[[Gaussians], float]
"""PSNR of a scene on held-out views, dB."""


@dataclass(frozen=True)
class Thrift:
    """What was left of a scene.

    Attributes:
        gaussians: those that are needed, in their order, with the harmonics that are needed.
        rows: int64, ascending: their row numbers in the scene that was given.
        lost_db: what that costs on the held-out views.
    """

    gaussians: Gaussians
    rows: NDArray[np.int64]
    lost_db: float


@torch.no_grad()
def seen_weight(gaussians: Gaussians, views: tuple[TrainingView, ...], backend: Backend = "cpu") -> NDArray[np.float64]:
    """[G]: max_views Σ_pixels w, the pixels that a Gaussian fills in the view that shows it best, at the views'
    smallest size; what fills none is never seen. (Mini-Splatting, Fang and Wang 2024, ranks by the sum over views,
    which would take first what few views see.)"""
    device = device_of(backend)
    splats = Splats(
        torch.from_numpy(gaussians.means).to(device),
        torch.from_numpy(gaussians.quats).to(device),
        torch.exp(torch.from_numpy(gaussians.log_scales)).to(device),
        torch.sigmoid(torch.from_numpy(gaussians.logit_opacities)).to(device),
        torch.zeros(len(gaussians), 1, device=device),
    )
    most = np.zeros(len(gaussians))
    for view in views:
        camera = view.frames[0].camera
        ones = torch.ones(camera.height, camera.width, 1, device=device)
        filled = blend_sums(splats, view.viewmat, camera, ones, backend=backend)[:, 0].double().cpu().numpy()
        most = np.maximum(most, filled)
    return most


def without_surplus(gaussians: Gaussians, weight: NDArray[np.float64], quality: Quality, allowed_db: float) -> Thrift:
    """The scene without harmonics and Gaussians that hardly matter: all of it together costs at most `allowed_db`.

    Harmonics go first, the highest degrees together, for up to half of the allowance: with few views they may even do
    harm. Then Gaussians go, those that fill the fewest pixels first, as many as the allowance bears (to 1/64 of them).

    Args:
        gaussians: a finished scene.
        weight: [G], `seen_weight`.
        quality: measures a scene of some of these Gaussians.
        allowed_db: how much worse it may get; 0 or less takes nothing away.
    """
    everything = np.arange(len(gaussians))
    if allowed_db <= 0 or not len(gaussians):
        return Thrift(gaussians, everything, 0.0)
    whole = quality(gaussians)
    kept, least = gaussians, whole - allowed_db
    for degree in range(gaussians.sh_degree):
        flatter = replace(gaussians, sh=np.ascontiguousarray(gaussians.sh[:, : (degree + 1) ** 2]))
        if quality(flatter) >= whole - allowed_db / 2:
            kept = flatter
            break
    order = np.argsort(weight, kind="stable")
    best, rows = kept, everything
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        share = (low + high) / 2
        some = np.sort(order[int(share * len(order)) :])
        fewer = _rows_of(kept, some)
        if quality(fewer) >= least:
            low, best, rows = share, fewer, some
        else:
            high = share
    return Thrift(best, rows, whole - quality(best))


def _rows_of(gaussians: Gaussians, rows: NDArray[np.int64]) -> Gaussians:
    return Gaussians(**{name: np.ascontiguousarray(array[rows]) for name, array in vars(gaussians).items()})
