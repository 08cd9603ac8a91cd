"""When and where a run moves and adds Gaussians (3DGS-MCMC, Kheradmand et al. 2024)."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from fastsplat.service.splatting.gaussians import activate_opacities, activate_scales, rotate
from fastsplat.service.splatting.state import GAUSSIAN_PARAMETERS, SplatState, Step
from fastsplat.service.splatting.torch_runtime import release_free_memory
from fastsplat.service.splatting.training.schedule import event_due
from fastsplat.service.splatting.training_settings import TrainingSettings

_DEAD_OPACITY = 0.005
"""A Gaussian less opaque than this is relocated."""
MAX_COPIES = 16
"""No Gaussian is cut into more parts than this at once; the sums below lose precision beyond."""


def densify_if_due(state: SplatState, step: Step, settings: TrainingSettings, start_count: int, budget: int) -> None:
    """Move dead Gaussians of a run to where opacity is, and add new ones there, on a schedule (3DGS-MCMC without its
    noise). Random numbers are drawn from seed and iteration alone, so that a continued run ends as one that was not
    interrupted.

    Args:
        state: after an optimizer step; all of its tensors may become longer ones.
        step: that it has just done.
        settings: the run's.
        start_count: Gaussians at the start of the run.
        budget: Gaussians at most.
    """
    progress = step.progress
    if not event_due(step.progress_before, progress, settings.densify_events):
        return
    if not settings.densify_from <= progress <= settings.densify_until:
        return
    target = planned_count(progress, start_count, budget, settings.densify_from, settings.full_count_at)
    seed = np.random.SeedSequence((settings.seed, 4, state.iteration)).generate_state(1, np.uint64)
    generator = torch.Generator().manual_seed(int(seed[0] >> 1))
    need = activate_opacities(state.parameters["logit_opacities"].detach())
    relocate_and_grow(state, need, target, _DEAD_OPACITY, generator)
    release_free_memory()


def split_in_place(opacities: Tensor, scales: Tensor, copies: Tensor) -> tuple[Tensor, Tensor]:
    """Opacity and scale of each of `copies` equal parts that, all at one place, composite to about the Gaussian they
    replace (eq. 9 of 3DGS-MCMC).

    Args:
        opacities: [G], 0..1.
        scales: [G, 3].
        copies: int [G], parts n of each, 1..`MAX_COPIES` (larger ones are clamped); 1 changes nothing.

    Returns:
        opacities [G]: 1 − (1 − o)^(1/n), and scales [G, 3]: s · o / Σ_{k<n} C(n, k+1) (−1)^k / √(k+1) · o_n^(k+1),
        which keeps the integral of the composited profile.
    """
    count = copies.clamp(1, MAX_COPIES)
    opacity = opacities.double().clamp(1e-8, 1 - 1e-8)
    part = 1 - (1 - opacity) ** (1 / count)
    powers = part[:, None] ** torch.arange(1, MAX_COPIES + 1, device=part.device)
    total = (_COEFFICIENTS.to(part.device)[count - 1] * powers).sum(dim=1)
    return part.to(opacities.dtype), (scales.double() * (opacity / total)[:, None]).to(scales.dtype)


def planned_count(progress: float, start: int, budget: int, grow_from: float, grow_until: float) -> int:
    """Gaussians that a run should have at `progress`: geometric growth from `start` to `budget` in between."""
    if start >= budget or progress >= grow_until:
        return budget
    if progress <= grow_from:
        return start
    share = (progress - grow_from) / (grow_until - grow_from)
    return min(budget, round(start * math.exp(share * math.log(budget / start))))


@torch.no_grad()
def relocate_and_grow(
    state: SplatState, need: Tensor, target: int, dead_opacity: float, generator: torch.Generator
) -> int:
    """Moves dead Gaussians to where they are needed, adds new ones up to `target`, and returns how many were placed.

    Sources are drawn from the living with probability ∝ `need` [G]; each is split into itself and its copies, which are
    scattered within its extent, or they would never part. Adam's moments of what was touched restart from zero.
    `generator` is the CPU's, so that a seed means the same draws on every device.
    """
    parameters = state.parameters
    opacities = activate_opacities(parameters["logit_opacities"])
    dead = torch.nonzero(opacities <= dead_opacity)[:, 0]
    need = torch.where(opacities > dead_opacity, need, 0).double()
    added = max(0, target - state.count)
    placed = len(dead) + added
    if placed == 0 or not float(need.sum()) > 0:
        return 0
    sources = torch.multinomial(need.cpu(), placed, replacement=True, generator=generator).to(need.device)
    copies = torch.bincount(sources, minlength=state.count) + 1
    parts = torch.unique(sources)
    scales = activate_scales(parameters["log_scales"][parts])
    opacity, scale = split_in_place(opacities[parts], scales, copies[parts])
    parameters["logit_opacities"][parts] = torch.logit(opacity.clamp(dead_opacity * 1.01 + 1e-6, 1 - 1e-6))
    parameters["log_scales"][parts] = torch.log(scale)
    for name in GAUSSIAN_PARAMETERS:
        copy = parameters[name].detach()[sources]
        if name == "means":
            copy = _scattered(state, sources, generator)
        parameters[name][dead] = copy[: len(dead)]
        for moments in (state.exp_avg, state.exp_avg_sq):
            moments[name][parts] = 0
            moments[name][dead] = 0
        if added:
            value = torch.cat([parameters[name].detach(), copy[len(dead) :]])
            parameters[name] = value.requires_grad_()
            for moments in (state.exp_avg, state.exp_avg_sq):
                moments[name] = torch.cat([moments[name], torch.zeros_like(value[len(moments[name]) :])])
    return placed


def _scattered(state: SplatState, sources: Tensor, generator: torch.Generator) -> Tensor:
    """[len(sources), 3]: centers drawn from the sources' own Gaussians."""
    scales = activate_scales(state.parameters["log_scales"][sources])
    offset = torch.randn(len(sources), 3, generator=generator).to(scales.device) * scales
    return state.parameters["means"][sources] + rotate(state.parameters["quats"][sources], offset)


_COEFFICIENTS = torch.tensor(
    [[math.comb(n, k + 1) * (-1) ** k / (k + 1) ** 0.5 for k in range(MAX_COPIES)] for n in range(1, MAX_COPIES + 1)],
    dtype=torch.float64,
)
"""[n − 1, k] = C(n, k + 1) (−1)^k / √(k + 1)."""
