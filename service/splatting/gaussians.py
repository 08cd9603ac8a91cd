"""Converts Gaussians between trainer, scene and rasterizer, including activation as in 3DGS."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.scene.artefact.scene import Gaussians, SemanticHead
from fastsplat.service.scene.gaussians.morton import morton_order
from fastsplat.service.splatting.raster.image_formation import Splats
from fastsplat_contract.errors import TrainingDivergedError

_SHAPES = ("means", "quats", "log_scales", "logit_opacities")


def activate_scales(log_scales: Tensor) -> Tensor:
    """Computes standard deviations in scene units, exp(log_scales); differentiable."""
    return torch.exp(log_scales)


def activate_opacities(logit_opacities: Tensor) -> Tensor:
    """Computes opacities 0..1, the logistic function; differentiable."""
    return torch.sigmoid(logit_opacities)


def rotate(quats: Tensor, vectors: Tensor) -> Tensor:
    """Rotates `vectors` [G, 3] by `quats` [G, 4] (w x y z, any length), on their device."""
    unit = torch.nn.functional.normalize(quats, dim=1)
    w, axis = unit[:, :1], unit[:, 1:]
    across = 2 * torch.linalg.cross(axis, vectors)
    rotated: Tensor = vectors + w * across + torch.linalg.cross(axis, across)
    return rotated


def splats_of(
    gaussians: Gaussians | Mapping[str, Tensor], features: Tensor | None = None, device: torch.device | None = None
) -> Splats:
    """Activates G Gaussians for the rasterizer.

    Args:
        gaussians: a scene's, copied as float32 to `device` (default CPU); or parameters, which stay in place and get
            gradients.
        features: [G, C] to composite; by default [G, 0].
    """
    if isinstance(gaussians, Gaussians):
        shapes = {name: np.asarray(getattr(gaussians, name)) for name in _SHAPES}
        gaussians = {name: torch.tensor(a, dtype=torch.float32, device=device) for name, a in shapes.items()}
    means = gaussians["means"]
    return Splats(
        means,
        gaussians["quats"],
        activate_scales(gaussians["log_scales"]),
        activate_opacities(gaussians["logit_opacities"]),
        means.new_zeros(len(means), 0) if features is None else features,
    )


def color_parameters(gaussians: Gaussians, device: torch.device | None = None) -> dict[str, Tensor]:
    """Returns a scene's color and geometry named as in `SplatState.parameters`; on the CPU means share memory."""
    colors = {"sh_dc": gaussians.sh[:, :1].copy(), "sh_rest": gaussians.sh[:, 1:].copy()}
    shapes = {name: getattr(gaussians, name) for name in _SHAPES}
    return {name: torch.from_numpy(array).to(device) for name, array in (shapes | colors).items()}


def current_gaussians(parameters: Mapping[str, Tensor]) -> Gaussians:
    """Exports all Gaussians in training order."""
    arrays = _arrays(parameters)
    return _take(arrays, np.arange(len(arrays["means"])))


def final_gaussians(parameters: Mapping[str, Tensor], cull_opacity: float) -> tuple[Gaussians, SemanticHead]:
    """Exports the head, and Gaussians above `cull_opacity` in Morton order.

    Raises:
        TrainingDivergedError: a parameter is not finite.
    """
    arrays = _arrays(parameters)
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise TrainingDivergedError(f"after the last step {name} is not finite")
    opacities = activate_opacities(parameters["logit_opacities"].detach().cpu().double()).numpy()
    visible = np.flatnonzero(opacities > cull_opacity)
    rows = visible[morton_order(arrays["means"][visible])]
    return _take(arrays, rows), SemanticHead(arrays["weight"].copy(), arrays["bias"].copy())


def _arrays(parameters: Mapping[str, Tensor]) -> dict[str, NDArray[np.float32]]:
    return {name: value.detach().cpu().numpy() for name, value in parameters.items()}


def _take(arrays: Mapping[str, NDArray[np.float32]], rows: NDArray[np.int64]) -> Gaussians:
    taken = {name: arrays[name][rows] for name in (*_SHAPES, "codes")}
    return Gaussians(**taken, sh=np.concatenate([arrays["sh_dc"][rows], arrays["sh_rest"][rows]], axis=1))
