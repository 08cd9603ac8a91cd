"""What a run changes: parameters and Adam's moments; and what it tells of a step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from fastsplat.service.splatting.optim import adam_update
from fastsplat.service.splatting.raster.image_formation import Backend

GAUSSIAN_PARAMETERS = ("means", "quats", "log_scales", "logit_opacities", "sh_dc", "sh_rest", "codes")
"""Row g of each belongs to Gaussian g. Others do not: "weight" and "bias" of the semantic head."""


@dataclass
class SplatState:
    """A run between two steps.

    Attributes:
        parameters: leaves of the autograd graph, float32; see `scene.Gaussians` for shapes; `sh_dc` is
            [G, 1, 3], `sh_rest` [G, K − 1, 3], `weight` [N + 1, D], `bias` [N + 1].
        exp_avg, exp_avg_sq: Adam's moments, shaped as the parameters.
    """

    parameters: dict[str, Tensor]
    exp_avg: dict[str, Tensor]
    exp_avg_sq: dict[str, Tensor]
    iteration: int = 0

    @property
    def count(self) -> int:
        """Gaussians in use."""
        return len(self.parameters["means"])

    def begin(self, name: str, value: Tensor) -> None:
        """Makes `value` a parameter of which nothing has been learned; its moments are zero."""
        self.parameters[name] = value.detach().requires_grad_()
        self.exp_avg[name], self.exp_avg_sq[name] = value.new_zeros(value.shape), value.new_zeros(value.shape)

    def keep(self, rows: Tensor) -> None:
        """Removes all Gaussians but those of `rows`, int64 [K], with their moments."""
        for name in GAUSSIAN_PARAMETERS:
            self.parameters[name] = self.parameters[name].detach()[rows].requires_grad_()
            for moments in (self.exp_avg, self.exp_avg_sq):
                moments[name] = moments[name][rows]

    def tensors(self) -> dict[str, Tensor]:
        """Everything but the iteration, on the CPU under flat names."""
        groups = {"parameter": self.parameters, "exp_avg": self.exp_avg, "exp_avg_sq": self.exp_avg_sq}
        return {f"{group}.{name}": t.detach().cpu() for group, values in groups.items() for name, t in values.items()}


@dataclass(frozen=True)
class Step:
    """One completed step of a run, for densification and the recorder.

    Attributes:
        progress_before, progress: of the run, 0..1, before and after the step.
        elapsed_s: seconds of optimization since the run began, those before a checkpoint included.
    """

    progress_before: float
    progress: float
    elapsed_s: float
    loss: float


def new_state(parameters: Mapping[str, Tensor], device: torch.device | None = None) -> SplatState:
    """A run before its first step, on `device` (default: where the parameters are)."""
    state = SplatState({}, {}, {})
    for name, value in parameters.items():
        # Cloned, because the start values may be the caller's own arrays.
        state.begin(name, value.detach().to(device, torch.float32, copy=True))
    return state


def restored_state(tensors: Mapping[str, Tensor], iteration: int, device: torch.device | None = None) -> SplatState:
    """The inverse of `SplatState.tensors`."""
    groups: dict[str, dict[str, Tensor]] = {"parameter": {}, "exp_avg": {}, "exp_avg_sq": {}}
    for key, value in tensors.items():
        group, name = key.split(".", 1)
        value = value.to(device)
        groups[group][name] = value.requires_grad_() if group == "parameter" else value
    return SplatState(groups["parameter"], groups["exp_avg"], groups["exp_avg_sq"], iteration)


def adam_step(state: SplatState, learning_rates: Mapping[str, float], backend: Backend = "cpu") -> None:
    """Takes one step of Adam on every parameter that has a gradient, and clears the gradients."""
    state.iteration += 1
    for name, param in state.parameters.items():
        if param.grad is None or param.numel() == 0:
            continue
        moments = state.exp_avg[name], state.exp_avg_sq[name]
        adam_update(param, param.grad, *moments, lr=learning_rates[name], step=state.iteration, backend=backend)
        param.grad = None
