"""Decides how many Gaussians and steps a scene requires, by views held out of training.

When the budget of Gaussians is in use, those go that the views can do without at a tolerance, and the run goes on with
the others. Once pictures look like the photos, or twice as many steps have gained less than the tolerance, that is done
at once, and the rest of the schedule is short. What was measured is in the run's state, so that a checkpoint holds it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from fastsplat.service.splatting.exposure.photometric_training import CORRECTIONS
from fastsplat.service.splatting.state import SplatState
from fastsplat.service.splatting.training.pruning import (
    MAX_EVAL_VIEWS,
    max_contribution,
    required_degree,
    required_rows,
)
from fastsplat.service.splatting.training.quality import measure_views
from fastsplat.service.splatting.training.schedule import run_progress
from fastsplat.service.splatting.training_settings import FEWEST_STEPS, TrainingSettings
from fastsplat.service.splatting.training_views import TrainingView

_ALIKE_DB = 40.0
"""PSNR from which on pictures are taken to look alike: more is no gain."""
_FAIR_DB = 30.0
"""PSNR below which steps that gain nothing do not end a run: there its pictures are small, or the photos disagree."""
_TAIL = 0.3
"""Once enough was done, the rest of the schedule takes this share of the steps before."""
_MEASURED, _LIMIT = "requirement.measured", "requirement.limit"


class Requirement:
    """The decisions of one run; without a tolerance it decides nothing.

    Args:
        views: training views.
        held_out: views that are not trained on; if there are none, training views are measured.
    """

    def __init__(
        self, settings: TrainingSettings, views: Sequence[TrainingView], held_out: Sequence[TrainingView]
    ) -> None:
        self._settings, self._views = settings, views
        judges = [view for view in held_out if view.frames[-1].has_content] or views
        self._judges = judges[:: math.ceil(len(judges) / MAX_EVAL_VIEWS)]

    def progress(self, state: SplatState, elapsed_s: float) -> float:
        """Progress of the run, 0..1, see `run_progress`; quicker once more is not required."""
        planned = run_progress(state.iteration, elapsed_s, self._settings)
        if not self._is_enough(state):
            return planned
        steps, before, _ = state.parameters[_MEASURED][-1].tolist()
        share = (state.iteration - steps) / math.ceil(_TAIL * steps)
        return float(min(1.0, max(planned, before + (1 - before) * share)))

    def budget(self, state: SplatState) -> int:
        """Gaussians that the run may have."""
        return int(state.parameters.get(_LIMIT, torch.tensor(self._settings.max_gaussians)))

    @torch.no_grad()
    def after_step(self, state: SplatState, progress: float) -> None:
        """Decides what is due after a step that ended at `progress`."""
        parameters = state.parameters
        if not self._settings.tolerance_db or state.iteration < FEWEST_STEPS:
            return
        if _is_milestone(state.iteration) and not self._is_enough(state):
            row = parameters["means"].new_tensor([[state.iteration, progress, self._psnr(parameters)]])
            parameters[_MEASURED] = torch.cat([parameters.get(_MEASURED, row[:0]), row])
        if _LIMIT not in parameters and (self._is_enough(state) or progress >= self._settings.full_count_at):
            state.keep(self._required(parameters, self._settings.tolerance_db))
            parameters[_LIMIT] = parameters["means"].new_tensor(float(state.count))

    @torch.no_grad()
    def finish(self, state: SplatState) -> None:
        """Removes, after the last step, harmonics that are not required; and Gaussians, where pictures are alike."""
        if not self._settings.tolerance_db:
            return
        if self._psnr(state.parameters) >= _ALIKE_DB:
            state.keep(self._required(state.parameters, 0.0))
        if state.count:
            degree = required_degree(state.parameters, self._psnr, self._settings.tolerance_db / 4)
            state.begin("sh_rest", state.parameters["sh_rest"][:, : (degree + 1) ** 2 - 1])

    def figures(self, state: SplatState) -> dict[str, float]:
        """For a scene's quality, see `TrainedSplats`."""
        measured = state.parameters.get(_MEASURED, torch.zeros(0, 3))[:, -1].tolist()
        figures = {"enough": float(self._is_enough(state)), "tolerance_db": self._settings.tolerance_db}
        return figures | ({"last_doubling_db": measured[-1] - measured[-3]} if len(measured) > 2 else {})

    def _required(self, parameters: Mapping[str, Tensor], tolerance_db: float) -> Tensor:
        views = [(view.viewmat, view.frames[0].camera) for view in self._views]
        contribution = max_contribution(parameters, views, self._settings.backend)
        return required_rows(parameters, contribution, self._psnr, tolerance_db)

    def _is_enough(self, state: SplatState) -> bool:
        psnr = state.parameters.get(_MEASURED, torch.zeros(0, 3))[:, -1].tolist()
        stagnates = len(psnr) > 2 and _FAIR_DB <= psnr[-1] < psnr[-3] + self._settings.tolerance_db
        return bool(psnr) and (psnr[-1] >= _ALIKE_DB or stagnates)

    def _psnr(self, parameters: Mapping[str, Tensor]) -> float:
        figures = measure_views(parameters, self._judges, self._settings.backend)
        name = "psnr_cc" if CORRECTIONS in parameters else "psnr"
        return float(min(figures.get(name, _ALIKE_DB), _ALIKE_DB))


def _is_milestone(iteration: int) -> bool:
    """Two in each doubling of the steps, from the fewest on."""
    number = round(2 * math.log2(iteration / FEWEST_STEPS))
    return iteration == round(FEWEST_STEPS * 2 ** (number / 2))
