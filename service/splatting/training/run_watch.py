"""Notices that a run goes astray, and takes it back to its last good state.

Photos that contradict each other, by light, poses or what moves, may come to be explained each by Gaussians of its own,
right before its camera. Then the loss rises again over hundreds of steps, or what is opaque gathers at the cameras. In
a long run whose learning rates stay high the loss may rise once, too: then they are lowered, and photos left alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from fastsplat.service.splatting.exposure.photometric_training import CORRECTIONS, begin_corrections
from fastsplat.service.splatting.gaussians import activate_opacities
from fastsplat.service.splatting.state import GAUSSIAN_PARAMETERS, SplatState
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import TrainingView

_WINDOW = 100
"""Steps that the loss is averaged over, rounded up to whole epochs, so that the order of the views does not count."""
_RISE, _RISES = 1.2, 2
"""The loss has risen when it was so many times the lowest in so many windows in a row."""
_NEAR, _GATHERED = 0.15, 0.05
"""Gaussians gather when the share of the opaque within `_NEAR` of a camera's median distance to the start points is
larger by `_GATHERED` than in the last good state."""
_OPAQUE, _FEWEST_OPAQUE, _SAMPLE = 0.5, 100, 4_096
_MOST_RETURNS = 3
_RATE, _WARM_UP = 0.5, 100
"""Each return multiplies the learning rates by the first; they begin at zero and are whole after so many steps."""

_WATCH, _RETURNS, _GOOD = "watch", "watch_returns", "good."
_STEPS, _SUM, _PHASE, _BEST, _NEAR_SHARE, _RISEN, _GOOD_AT = range(7)


class RunWatch:
    """Watches a run; everything it knows is in the run's state, so that a checkpoint holds it.

    Args:
        views: training views.
        points: float32 [P, 3] that the run started from.
    """

    def __init__(self, views: Sequence[TrainingView], points: Tensor, settings: TrainingSettings) -> None:
        self._settings = settings
        self._window = math.ceil(_WINDOW / len(views)) * len(views)
        self._cameras = torch.stack([view.position for view in views])
        some = points[:: math.ceil(len(points) / _SAMPLE)].to(self._cameras.device)
        self._near = _NEAR * torch.cdist(some, self._cameras).median(dim=0).values

    def rate(self, state: SplatState) -> float:
        """What the learning rates are multiplied by."""
        returns = state.parameters.get(_RETURNS)
        if returns is None:
            return 1.0
        since = state.iteration + 1 - int(returns[-1, 0])
        return float(_RATE ** len(returns) * min(1.0, since / _WARM_UP))

    @torch.no_grad()
    def after_step(self, state: SplatState, image_loss: Tensor, phase: int) -> None:
        """Takes the run back if it went astray, at the end of a window.

        Args:
            image_loss: of the step, of one number.
            phase: of the schedule; the losses of two phases cannot be compared.
        """
        if _WATCH not in state.parameters:
            state.parameters[_WATCH] = image_loss.new_zeros(7)
        noted = state.parameters[_WATCH].detach()
        noted[_SUM] += image_loss
        noted[_STEPS] += 1
        if state.iteration % self._window:
            return
        steps, total, before, best, share, risen, good_at = noted.tolist()
        noted[:2] = 0
        if steps < self._window:
            return
        changed, loss, near = phase != before, total / steps, self._near_share(state)
        noted[_PHASE] = phase
        noted[_RISEN] = risen = risen + 1 if best and not changed and loss > _RISE * best else 0
        better = not best or loss < best
        gathered = near > share + _GATHERED and (changed or not best or not better)
        if good_at and (gathered or risen >= _RISES):
            if len(state.parameters.get(_RETURNS, ())) < _MOST_RETURNS:
                self._go_back(state, gathered)
        elif changed:
            noted[_BEST] = 0  # of no window: this one had steps of both phases
        elif better:
            noted[_BEST], noted[_NEAR_SHARE], noted[_GOOD_AT] = loss, near, state.iteration
            for name in GAUSSIAN_PARAMETERS:
                state.parameters[_GOOD + name] = state.parameters[name].detach().clone()

    def _near_share(self, state: SplatState) -> float:
        opaque = activate_opacities(state.parameters["logit_opacities"].detach()) > _OPAQUE
        means = state.parameters["means"].detach()[opaque]
        if len(means) < _FEWEST_OPAQUE:
            return 0.0
        some = means[:: math.ceil(len(means) / _SAMPLE)]
        return float((torch.cdist(some, self._cameras) < self._near).any(dim=1).float().mean())

    def _go_back(self, state: SplatState, gathered: bool) -> None:
        """Restores the Gaussians of the last good state, corrects photos that seem to differ, and notes it."""
        noted = state.parameters[_WATCH].detach()
        returns = state.parameters.get(_RETURNS, noted.new_zeros(0, 2))
        noted[_RISEN], noted[_PHASE] = 0, -1
        for name in GAUSSIAN_PARAMETERS:
            state.begin(name, state.parameters[_GOOD + name].clone())
        if (gathered or len(returns)) and self._settings.photometric != "off" and len(self._cameras) > 1:
            begin_corrections(state, len(self._cameras))
        row = noted.new_tensor([[float(state.iteration), float(noted[_GOOD_AT])]])
        state.parameters[_RETURNS] = torch.cat([returns, row])


def return_warnings(state: SplatState) -> tuple[str, ...]:
    """A sentence for each time that a run was taken back."""
    corrected = " and each photo's exposure corrected. Do photos differ in light, have objects moved, are poses wrong?"
    ending = corrected if CORRECTIONS in state.parameters else "."
    return tuple(
        f"Training went astray: at step {at:.0f} it went back to step {good:.0f}, with lower learning rates{ending}"
        for at, good in state.parameters.get(_RETURNS, torch.zeros(0, 2)).tolist()
    )
