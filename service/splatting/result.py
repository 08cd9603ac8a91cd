"""From a run's state to the scene that it leaves."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.scene.types import Gaussians, SemanticHead
from fastsplat.service.splatting.morton import morton_order
from fastsplat.service.splatting.semantics import ghost_share
from fastsplat.service.splatting.state import SplatState
from fastsplat_contract.errors import TrainingDivergedError


def final_scene(state: SplatState, cull_opacity: float) -> tuple[Gaussians, SemanticHead]:
    """Gaussians with an opacity above `cull_opacity` in Morton order, and the head.

    Raises:
        TrainingDivergedError: a parameter is not finite.
    """
    arrays = {name: value.detach().cpu().numpy() for name, value in state.parameters.items()}
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise TrainingDivergedError(f"after iteration {state.iteration} {name} is not finite")
    opacities = 1 / (1 + np.exp(-arrays["logit_opacities"].astype(np.float64)))
    visible = np.flatnonzero(opacities > cull_opacity)
    rows = visible[morton_order(arrays["means"][visible])]
    return _gaussians(arrays, rows), SemanticHead(arrays["weight"].copy(), arrays["bias"].copy())


def present_gaussians(state: SplatState) -> Gaussians:
    """All Gaussians of a run under way, in its own order."""
    arrays = {name: value.detach().cpu().numpy() for name, value in state.parameters.items()}
    return _gaussians(arrays, np.arange(state.count))


def _gaussians(arrays: Mapping[str, NDArray[np.float32]], rows: NDArray[np.int64]) -> Gaussians:
    return Gaussians(
        means=arrays["means"][rows],
        quats=arrays["quats"][rows],
        log_scales=arrays["log_scales"][rows],
        logit_opacities=arrays["logit_opacities"][rows],
        sh=np.concatenate([arrays["sh_dc"][rows], arrays["sh_rest"][rows]], axis=1),
        codes=arrays["codes"][rows],
    )


def ghosts_of(gaussians: Gaussians, head: SemanticHead) -> float:
    """`ghost_share` of a finished scene."""
    return ghost_share(
        torch.from_numpy(gaussians.codes),
        torch.sigmoid(torch.from_numpy(gaussians.logit_opacities)),
        torch.from_numpy(head.weight),
        torch.from_numpy(head.bias),
    )


def color_parameters(gaussians: Gaussians) -> dict[str, Tensor]:
    """The colour part of a finished scene under the names of `SplatState.parameters`, to be rendered."""
    return {
        "means": torch.from_numpy(gaussians.means),
        "quats": torch.from_numpy(gaussians.quats),
        "log_scales": torch.from_numpy(gaussians.log_scales),
        "logit_opacities": torch.from_numpy(gaussians.logit_opacities),
        "sh_dc": torch.from_numpy(gaussians.sh[:, :1].copy()),
        "sh_rest": torch.from_numpy(gaussians.sh[:, 1:].copy()),
    }
