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
from fastsplat.service.splatting.training_settings import FEWEST_STEPS, GAIN_OF_DOUBLING, TrainingSettings
from fastsplat.service.splatting.training_views import TrainingView

_ALIKE_DB = 40.0
"""PSNR from which on pictures are taken to look alike: more is no gain."""
_FAIR_DB = 30.0
"""PSNR below which steps that gain nothing do not end a run: there its pictures are small, or the photos disagree."""
_SAVING, _HARMONICS = 1 / 6, 1 / 12
"""Shares of the tolerance that may be lost: with Gaussians, or with steps, that are spared; and with harmonics."""
_TAIL = 0.3
"""Once enough was done, the rest of the schedule takes this share of the steps before."""
_MEASURED, _LIMIT = "requirement.measured", "requirement.limit"


class Requirement:
    """The decisions of one run; without a tolerance it decides nothing.

    Args:
        views: training views.
        held_out: views that are not trained on; if they show nothing, training views are measured.
        state: of a new run or of a checkpoint. It is read once, as a GPU has to be waited for.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        views: Sequence[TrainingView],
        held_out: Sequence[TrainingView],
        state: SplatState,
    ) -> None:
        self._settings, self._views, self._state = settings, views, state
        judges = [view for view in held_out if view.frames[-1].has_content] or views
        self._saving_db = _SAVING * settings.tolerance_db
        self._judges = judges[:: math.ceil(len(judges) / MAX_EVAL_VIEWS)]
        measured, limit = state.parameters.get(_MEASURED), state.parameters.get(_LIMIT)
        self._measured: list[list[float]] = [] if measured is None else measured.tolist()
        self._limit = None if limit is None else int(limit)

    def progress(self, elapsed_s: float) -> float:
        """Progress of the run, 0..1, see `run_progress`; quicker once more is not required."""
        planned = run_progress(self._state.iteration, elapsed_s, self._settings)
        if not self._is_enough():
            return planned
        steps, before, _ = self._measured[-1]
        share = (self._state.iteration - steps) / math.ceil(_TAIL * steps)
        return min(1.0, max(planned, before + (1 - before) * share))

    @property
    def budget(self) -> int:
        """Gaussians that the run may have."""
        return self._settings.max_gaussians if self._limit is None else self._limit

    @torch.no_grad()
    def after_step(self, progress: float) -> None:
        """Decides what is due after a step that ended at `progress`."""
        state, parameters = self._state, self._state.parameters
        if not self._settings.tolerance_db or state.iteration < FEWEST_STEPS:
            return
        if _is_milestone(state.iteration) and not self._is_enough():
            row = [float(state.iteration), progress, self._psnr(parameters)]
            parameters[_MEASURED] = torch.tensor([*self._measured, row])
            self._measured = parameters[_MEASURED].tolist()  # as a checkpoint has it
        is_due = self._is_enough() or progress >= self._settings.full_count_at
        if is_due and (self._limit is None or state.count > self._limit):  # again where the run was taken back
            self._prune(self._psnr(parameters) - self._saving_db)
            parameters[_LIMIT] = torch.tensor(float(state.count))
            self._limit = state.count

    @torch.no_grad()
    def finish(self) -> None:
        """Removes, after the last step, harmonics that are not required; and Gaussians, where pictures are alike."""
        state = self._state
        if not self._settings.tolerance_db:
            return
        psnr = self._psnr(state.parameters)
        if psnr >= _ALIKE_DB:
            self._prune(_ALIKE_DB)
        if state.count:
            degree = required_degree(state.parameters, self._psnr, psnr - _HARMONICS * self._settings.tolerance_db)
            state.begin("sh_rest", state.parameters["sh_rest"][:, : (degree + 1) ** 2 - 1])

    def figures(self) -> dict[str, float]:
        """For a scene's quality, see `TrainedSplats`."""
        gain = GAIN_OF_DOUBLING / max(self._state.iteration, FEWEST_STEPS)  # by the mean curve of captures
        if enough := self._is_enough():
            gain = 0.0 if self._measured[-1][-1] >= _ALIKE_DB else max(0.0, self._last_doubling_db())
        return {"enough": float(enough), "tolerance_db": self._settings.tolerance_db, "next_doubling_db": gain}

    def _prune(self, least_db: float) -> None:
        views = [(view.viewmat, view.frames[0].camera) for view in self._views]
        parameters = self._state.parameters
        contribution = max_contribution(parameters, views, self._settings.backend)
        self._state.keep(required_rows(parameters, contribution, self._psnr, least_db))

    def _last_doubling_db(self) -> float:
        return self._measured[-1][-1] - self._measured[-3][-1] if len(self._measured) > 2 else math.inf

    def _is_enough(self) -> bool:
        if not self._measured:
            return False
        psnr = self._measured[-1][-1]
        return psnr >= _ALIKE_DB or (psnr >= _FAIR_DB and self._last_doubling_db() < self._saving_db)

    def _psnr(self, parameters: Mapping[str, Tensor]) -> float:
        name = "psnr_cc" if CORRECTIONS in parameters else "psnr"
        figures = measure_views(parameters, self._judges, self._settings.backend, (name,))
        return min(figures.get(name, _ALIKE_DB), _ALIKE_DB)


def _is_milestone(iteration: int) -> bool:
    """Two in each doubling of the steps, from the fewest on."""
    number = round(2 * math.log2(iteration / FEWEST_STEPS))
    return iteration == round(FEWEST_STEPS * 2 ** (number / 2))
