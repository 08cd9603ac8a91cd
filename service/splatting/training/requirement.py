"""Decides how many Gaussians and steps a scene requires, by views held out of training.

A run goes through rounds, each twice as long as what went before, up to the whole budget. In its first half a round
multiplies the Gaussians; then those go that the views can do without at the tolerance, and learning rates fall to
their last values, so that what a round has gained can be measured (warm restarts: Loshchilov and Hutter, 2017). The
run ends after a round that gained less than the tolerance. Everything that was measured is in the run's state, so that
a checkpoint holds it.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from fastsplat.service.splatting.exposure.photometric_training import CORRECTIONS
from fastsplat.service.splatting.state import SplatState, Step
from fastsplat.service.splatting.training.densify import planned_count
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

_ROUNDS = (0.0, 1 / 8, 1 / 4, 1 / 2, 1.0)
"""Progress at which rounds begin, and the last one ends."""
_GROWTH_ENDS = 0.5
"""Share of a round after which no Gaussian is added."""
_ALIKE_DB = 40.0
"""PSNR from which on pictures are taken to look alike: more is no gain."""
_MEASURED, _COUNT, _PRUNED = "requirement.measured", "requirement.count", "requirement.pruned"


class Requirement:
    """The decisions of one run; without a tolerance it decides nothing.

    Args:
        views: training views.
        held_out: views that are not trained on; if there are none, training views are measured.
        start_count: Gaussians at the start of the run.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        views: Sequence[TrainingView],
        held_out: Sequence[TrainingView],
        start_count: int,
    ) -> None:
        self._settings, self._views, self._start_count = settings, views, start_count
        judges = held_out or views
        self._judges = judges[:: math.ceil(len(judges) / MAX_EVAL_VIEWS)]

    def progress(self, state: SplatState, elapsed_s: float) -> float:
        """Progress of the run, 0..1, see `run_progress`; 1 once more is not required."""
        return 1.0 if self._is_enough(state) else run_progress(state.iteration, elapsed_s, self._settings)

    def round_of(self, progress: float) -> int:
        """Number of the round at a progress."""
        return bisect_right(_ROUNDS[1:-1], progress) if self._settings.tolerance_db else len(_ROUNDS) - 2

    def annealing(self, progress: float) -> float:
        """Progress whose learning rates apply: the last ones at the end of each round."""
        if not self._settings.tolerance_db:
            return progress
        start = _ROUNDS[self.round_of(progress)]
        return start + (1 - start) * self._share(progress)

    def planned_count(self, state: SplatState, progress: float) -> int:
        """Gaussians that the run should have: geometric growth in the first half of each round but the last."""
        settings, start = self._settings, self._start_count
        if not settings.tolerance_db:
            return planned_count(progress, start, settings.max_gaussians, settings.densify_from, settings.full_count_at)
        if _PRUNED in state.parameters or self.round_of(progress) == len(_ROUNDS) - 2:
            return state.count
        before = int(state.parameters.get(_COUNT, torch.tensor(start)))
        factor = max(2.0, (settings.max_gaussians / start) ** (1 / (len(_ROUNDS) - 2)))
        share = min(1.0, self._share(progress) / _GROWTH_ENDS)
        return min(settings.max_gaussians, round(before * factor**share))

    @torch.no_grad()
    def after_step(self, state: SplatState, step: Step) -> None:
        """Prunes in the middle of a round, and measures at its end."""
        if not self._settings.tolerance_db:
            return
        before, now = self.round_of(step.progress_before), self.round_of(step.progress)
        if before != now:
            self._measure(state)
        elif now == len(_ROUNDS) - 2 and self._share(step.progress) >= _GROWTH_ENDS and _PRUNED not in state.parameters:
            self._prune(state)

    @torch.no_grad()
    def flattened(self, parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Parameters without the degrees of harmonics that are not required."""
        degree = self._settings.max_sh_degree
        if self._settings.tolerance_db:
            degree = required_degree(parameters, self._psnr, self._settings.tolerance_db / 2)
        if not len(parameters["means"]):
            degree = 0
        return {**parameters, "sh_rest": parameters["sh_rest"][:, : (degree + 1) ** 2 - 1]}

    def figures(self, state: SplatState) -> dict[str, float]:
        """What the run has decided, for a scene's quality; see `TrainedSplats`."""
        psnr = self._measured(state)
        if len(psnr) < 2:
            return {}
        return {"tolerance_db": self._settings.tolerance_db, "last_doubling_db": psnr[-1] - psnr[-2]}

    def _share(self, progress: float) -> float:
        start, end = _ROUNDS[(number := self.round_of(progress)) : number + 2]
        return (progress - start) / (end - start)

    def _measure(self, state: SplatState) -> None:
        means, psnr = state.parameters["means"], self._measured(state)
        if state.iteration >= FEWEST_STEPS:
            state.parameters[_MEASURED] = means.new_tensor([*psnr, self._psnr(state.parameters)])
        if self._is_enough(state) and self._measured(state)[-1] >= _ALIKE_DB:
            self._prune(state)  # to that
        state.parameters[_COUNT] = means.new_tensor(float(state.count))
        state.parameters.pop(_PRUNED, None)

    def _prune(self, state: SplatState) -> None:
        state.parameters[_PRUNED] = state.parameters["means"].new_ones(())
        if state.iteration < FEWEST_STEPS // 2:
            return
        views = [(view.viewmat, view.frames[0].camera) for view in self._views]
        contribution = max_contribution(state.parameters, views, self._settings.backend)
        state.keep(required_rows(state.parameters, contribution, self._psnr, self._settings.tolerance_db))

    def _is_enough(self, state: SplatState) -> bool:
        """True if nothing is left to gain, or the last round has gained less than the tolerance."""
        psnr = self._measured(state)
        if not psnr:
            return False
        return psnr[-1] >= _ALIKE_DB or (len(psnr) > 1 and psnr[-1] - psnr[-2] < self._settings.tolerance_db)

    def _measured(self, state: SplatState) -> list[float]:
        measured = state.parameters.get(_MEASURED)
        return [] if measured is None else measured.tolist()

    def _psnr(self, parameters: Mapping[str, Tensor]) -> float:
        figures = measure_views(parameters, self._judges, self._settings.backend)
        name = "psnr_cc" if CORRECTIONS in parameters else "psnr"
        return float(min(figures.get(name, _ALIKE_DB), _ALIKE_DB))
