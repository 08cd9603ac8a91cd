"""Densification: which Gaussians a run moves, adds or removes, and when (the seam of gsplat's strategies)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch

from fastsplat.service.splatting.densify import planned_count, relocate_and_grow
from fastsplat.service.splatting.gaussians import activate_opacities
from fastsplat.service.splatting.schedule import event_due
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.state import SplatState, Step
from fastsplat.service.splatting.torch_runtime import release_free_memory

_DEAD_OPACITY = 0.005
"""A Gaussian less opaque than this is relocated."""


class DensificationStrategy(Protocol):
    """Decides over number and places of a run's Gaussians, by random numbers from (seed, iteration) and what a
    checkpoint holds alone."""

    def step_post_backward(self, state: SplatState, step: Step) -> None:
        """Called after every optimizer step. May replace rows of `state`, or all of its tensors by longer or shorter
        ones; parameters stay leaves of the autograd graph, and moments keep their shapes."""


@dataclass(frozen=True)
class RelocationStrategy:
    """Dead Gaussians are moved to where opacity is, and new ones added there, on a schedule (3DGS-MCMC without its
    noise).

    Attributes:
        start_count: Gaussians at the start of the run.
    """

    settings: TrainingSettings
    start_count: int

    def step_post_backward(self, state: SplatState, step: Step) -> None:
        """See `DensificationStrategy`."""
        settings, progress = self.settings, step.progress
        if not event_due(step.progress_before, progress, settings.densify_events):
            return
        if not settings.densify_from <= progress <= settings.densify_until:
            return
        target = planned_count(
            progress, self.start_count, settings.max_gaussians, settings.densify_from, settings.full_count_at
        )
        seed = np.random.SeedSequence((settings.seed, 4, state.iteration)).generate_state(1, np.uint64)
        generator = torch.Generator().manual_seed(int(seed[0] >> 1))
        need = activate_opacities(state.parameters["logit_opacities"].detach())
        relocate_and_grow(state, need, target, _DEAD_OPACITY, generator)
        release_free_memory()
