"""What a run changes: parameters, Adam's moments, and the number and places of the Gaussians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from fastsplat.service.splatting.densify import split_in_place
from fastsplat.service.splatting.optim import adam_update
from fastsplat.service.splatting.raster import Backend

GAUSSIAN_PARAMETERS = ("means", "quats", "log_scales", "logit_opacities", "sh_dc", "sh_rest", "codes")
"""Row g of each belongs to Gaussian g; "weight" and "bias" of the semantic head are the only others."""


@dataclass
class SplatState:
    """A run between two steps.

    Attributes:
        parameters: leaves of the autograd graph, float32; see `service.scene.types.Gaussians` for shapes; `sh_dc` is
            [G, 1, 3], `sh_rest` [G, K − 1, 3], `weight` [N + 1, D], `bias` [N + 1].
        first, second: Adam's moments, shaped as the parameters.
        iteration: completed steps.
    """

    parameters: dict[str, Tensor]
    first: dict[str, Tensor]
    second: dict[str, Tensor]
    iteration: int = 0

    @property
    def count(self) -> int:
        """Gaussians in use."""
        return len(self.parameters["means"])

    def tensors(self) -> dict[str, Tensor]:
        """Everything but the iteration, on the CPU under flat names."""
        groups = {"parameter": self.parameters, "first": self.first, "second": self.second}
        return {f"{group}.{name}": t.detach().cpu() for group, values in groups.items() for name, t in values.items()}


def new_state(parameters: Mapping[str, Tensor], device: torch.device | None = None) -> SplatState:
    """A run before its first step, on `device` (default: where the parameters are)."""
    # Cloned, because the start values may be the caller's own arrays.
    leaves = {name: v.detach().to(device, torch.float32, copy=True).requires_grad_() for name, v in parameters.items()}
    return SplatState(
        leaves,
        {name: torch.zeros_like(value, requires_grad=False) for name, value in leaves.items()},
        {name: torch.zeros_like(value, requires_grad=False) for name, value in leaves.items()},
    )


def restored_state(tensors: Mapping[str, Tensor], iteration: int, device: torch.device | None = None) -> SplatState:
    """The inverse of `SplatState.tensors`."""
    groups: dict[str, dict[str, Tensor]] = {"parameter": {}, "first": {}, "second": {}}
    for key, value in tensors.items():
        group, name = key.split(".", 1)
        value = value.to(device)
        groups[group][name] = value.requires_grad_() if group == "parameter" else value
    return SplatState(groups["parameter"], groups["first"], groups["second"], iteration)


def adam_step(state: SplatState, rates: Mapping[str, float], backend: Backend = "cpu") -> None:
    """One step of Adam on every parameter that has a gradient; clears the gradients."""
    state.iteration += 1
    for name, value in state.parameters.items():
        if value.grad is None or value.numel() == 0:
            continue
        moments = state.first[name], state.second[name]
        adam_update(value, value.grad, *moments, rate=rates[name], step=state.iteration, backend=backend)
        value.grad = None


@torch.no_grad()
def relocate_and_grow(
    state: SplatState, need: Tensor, target: int, dead_opacity: float, generator: torch.Generator
) -> int:
    """Moves dead Gaussians to where they are needed and adds new ones until there are `target`.

    Sources are drawn from the living with probability ∝ `need` [G]; each is split into itself and its copies so that
    the picture stays the same. Their moments restart from zero. `generator` is the CPU's, so that a seed means the same
    draws on every device.

    Returns:
        How many Gaussians were placed.
    """
    parameters = state.parameters
    opacities = torch.sigmoid(parameters["logit_opacities"])
    dead = torch.nonzero(opacities <= dead_opacity)[:, 0]
    need = torch.where(opacities > dead_opacity, need, 0).double()
    added = max(0, target - state.count)
    placed = len(dead) + added
    if placed == 0 or not float(need.sum()) > 0:
        return 0
    sources = torch.multinomial(need.cpu(), placed, replacement=True, generator=generator).to(need.device)
    copies = torch.bincount(sources, minlength=state.count) + 1
    parts = torch.unique(sources)
    opacity, scale = split_in_place(opacities[parts], torch.exp(parameters["log_scales"][parts]), copies[parts])
    parameters["logit_opacities"][parts] = torch.logit(opacity.clamp(dead_opacity * 1.01 + 1e-6, 1 - 1e-6))
    parameters["log_scales"][parts] = torch.log(scale)
    for name in GAUSSIAN_PARAMETERS:
        copy = parameters[name].detach()[sources]
        if name == "means":
            copy = _scattered(state, sources, generator)
        parameters[name][dead] = copy[: len(dead)]
        for moments in (state.first, state.second):
            moments[name][parts] = 0
            moments[name][dead] = 0
        if added:
            value = torch.cat([parameters[name].detach(), copy[len(dead) :]])
            parameters[name] = value.requires_grad_()
            for moments in (state.first, state.second):
                moments[name] = torch.cat([moments[name], torch.zeros_like(value[len(moments[name]) :])])
    return placed


def _scattered(state: SplatState, sources: Tensor, generator: torch.Generator) -> Tensor:
    """Centres for copies of `sources`, drawn from the sources' own Gaussians: two at one place would never part."""
    scales = torch.exp(state.parameters["log_scales"][sources])
    offset = torch.randn(len(sources), 3, generator=generator).to(scales.device) * scales
    return state.parameters["means"][sources] + rotate(state.parameters["quats"][sources], offset)


def rotate(quats: Tensor, vectors: Tensor) -> Tensor:
    """`vectors` [G, 3] turned by unnormalised `quats` [G, 4] (w x y z)."""
    unit = torch.nn.functional.normalize(quats, dim=1)
    w, axis = unit[:, :1], unit[:, 1:]
    across = 2 * torch.linalg.cross(axis, vectors)
    turned: Tensor = vectors + w * across + torch.linalg.cross(axis, across)
    return turned
