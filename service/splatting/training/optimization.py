"""The optimization loop: one view a step."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from torch import Tensor

from fastsplat.service.splatting.exposure.photometric import correct
from fastsplat.service.splatting.exposure.photometric_training import PhotometricTraining
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.labels.label_supervision import LabelSupervision
from fastsplat.service.splatting.state import SplatState, Step, adam_step
from fastsplat.service.splatting.training.densify import densify_if_due
from fastsplat.service.splatting.training.depth_regularization import AnchorPoints, depth_anchors
from fastsplat.service.splatting.training.objective import loss_terms
from fastsplat.service.splatting.training.recorder import Recorder
from fastsplat.service.splatting.training.requirement import Requirement
from fastsplat.service.splatting.training.run_watch import RunWatch
from fastsplat.service.splatting.training.schedule import depth_regularized, image_level, learning_rates, sh_degree
from fastsplat.service.splatting.training_settings import FEWEST_STEPS, TrainingSettings
from fastsplat.service.splatting.training_views import TrainingView, render_frame
from fastsplat_contract.errors import InvalidInputError, TrainingDivergedError


class Trainer:
    """Optimizes a state until the run is over: render, compare, step; then densification and the recorder have their
    turn.

    Random numbers are drawn afresh from (seed, iteration), so a checkpoint need not hold any.

    Args:
        state: of a new run or of a checkpoint.
        anchor_points: of the capture, on the backend's device; there may be none.
        start_points: float32 [P, 3], one for each Gaussian at the start of the run.
        extent: of the scene, scene units.
        elapsed_s: seconds that the run has taken before.
        finish: whether to end the run early; asked once it has 250 steps.

    Attributes:
        progress: 0..1; below 1 after `run` if it ended early.
    """

    def __init__(
        self,
        state: SplatState,
        views: tuple[TrainingView, ...],
        *,
        anchor_points: AnchorPoints,
        supervision: LabelSupervision,
        start_points: Tensor,
        recorder: Recorder,
        requirement: Requirement,
        settings: TrainingSettings,
        extent: float,
        elapsed_s: float = 0.0,
        finish: Callable[[], bool] = lambda: False,
    ) -> None:
        self.state, self.views, self.elapsed_s = state, views, elapsed_s
        self._supervision, self._start_count, self._recorder = supervision, len(start_points), recorder
        self._anchor_points, self._requirement = anchor_points, requirement
        self._settings, self._extent = settings, extent
        self._finish = finish
        self._photometric = PhotometricTraining(settings)
        self._watch = RunWatch(views, start_points, settings)
        self.progress = 0.0

    def run(self) -> None:
        """Steps until progress is 1, or the run is to end early.

        Raises:
            TrainingDivergedError: the loss or a Gaussian became NaN or infinite.
        """
        begun = time.monotonic() - self.elapsed_s
        progress = self._requirement.progress(self.elapsed_s)
        self._recorder.start(self.state, self.elapsed_s, progress)
        while progress < 1 and not (self.state.iteration >= FEWEST_STEPS and self._finish()):
            loss = self._step(progress)
            self.elapsed_s = time.monotonic() - begun
            before, progress = progress, self._requirement.progress(self.elapsed_s)
            step = Step(before, progress, self.elapsed_s, loss)
            densify_if_due(self.state, step, self._settings, self._start_count, self._requirement.budget)
            self._requirement.after_step(progress)
            self._recorder.after_step(self.state, step)
        self.progress = progress
        self._recorder.finish(self.state, self.elapsed_s)

    def _step(self, progress: float) -> float:
        """The loss of one optimization step."""
        settings, iteration, parameters = self._settings, self.state.iteration, self.state.parameters
        number = self._view_of(iteration)
        view = self.views[number]
        level = image_level(progress, settings)
        frame = view.frames[level]
        semantic = self._supervision.applies(frame, iteration)
        regularized = depth_regularized(iteration, progress, settings, frame.depth is not None)
        self._photometric.decide_if_due(self.state)
        correction = self._photometric.correction(self.state, number)
        points = self._anchor_points
        if regularized and correction is not None:  # colored as the photo shows them
            points = replace(points, colors=correct(points.colors, correction.detach()).clamp(0, 1))
        anchors = depth_anchors(points, view, frame) if regularized else None
        splats = splats_of(parameters)
        rendering = render_frame(
            parameters,
            splats,
            view,
            frame,
            degree=sh_degree(progress, settings),
            with_codes=semantic,
            with_squared_depth=regularized,
            backend=settings.backend,
        )
        target = frame.target()
        self._recorder.observe_image(iteration, rendering.image[..., :3].detach(), target, frame, correction)
        class_weights = self._supervision.class_weights if semantic else None
        try:
            terms = loss_terms(
                rendering, splats, parameters, frame, target, class_weights, self._extent, settings, anchors, correction
            )
            loss = sum(terms.values(), start=next(iter(terms.values())).new_zeros(()))
            image_loss = terms["image"].detach()
            value, reason = loss.item(), f"{rendering.culled_non_finite} Gaussians are not finite"
        except InvalidInputError as error:
            value, reason = math.nan, str(error)
        if not math.isfinite(value) or rendering.culled_non_finite:
            raise TrainingDivergedError(
                f"at iteration {iteration} the loss is {value}: {reason}",
                hint="Lower the learning rates in training.rates, and check the poses and points of the capture.",
                field="training.rates",
            )
        fit = self._photometric.fit(self.state, progress, rendering, target, frame)
        del rendering, target, splats, terms  # the backward pass needs the memory, not them
        loss.backward()
        self._photometric.step(self.state, number, progress, fit)
        rates, rate = learning_rates(progress, self._extent, settings), self._watch.rate(self.state)
        adam_step(self.state, {name: value * rate for name, value in rates.items()}, settings.backend)
        phase = 4 * level + 2 * (progress >= settings.depth_from) + (correction is not None)
        self._watch.after_step(self.state, image_loss, phase)
        return value

    def _view_of(self, iteration: int) -> int:
        """The number of a view: every one once an epoch, in an order of the epoch's own."""
        epoch, position = divmod(iteration, len(self.views))
        order = np.random.default_rng((self._settings.seed, 2, epoch)).permutation(len(self.views))
        return int(order[position])
