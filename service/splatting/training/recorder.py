"""The recorder of a run: reports progress, loss and PSNR, and has checkpoints saved."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable

from torch import Tensor

from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.splatting.exposure.photometric import corrected_for
from fastsplat.service.splatting.state import SplatState, Step
from fastsplat.service.splatting.torch_runtime import release_free_memory
from fastsplat.service.splatting.training.previews import Previews
from fastsplat.service.splatting.training.quality import measure_views, psnr
from fastsplat.service.splatting.training.schedule import event_due, sh_degree
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import Frame, TrainingView

_REPORT_EVERY_S = 0.5
_PSNR_EVERY = 20
_MEAN_OF = 50
_SPEED_OF = 40
"""The speed of a run is that of its last so many reports (20 s at most), as later steps take longer than the first."""


class Recorder:
    """Reports a run and has its checkpoints saved; changes nothing of it.

    The loop calls `start`, then `observe_image` and `after_step` in every step, then `finish`.

    Args:
        progress: called with metrics iteration, elapsed_s, gaussians, iterations_per_second, random_points, loss and
            psnr, each once it is known.
        held_out: views whose PSNR is measured; without any, that of training images is.
        random_points: start points that were placed at random.
        save: writes a checkpoint of a state after so many seconds; None for no checkpoints.
        previews: takes pictures of the run; None for none.
        draft: is called with a state and the share of the run behind it, once after each of `drafts_at`.
        drafts_at: shares of the run, 0..1.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        progress: Progress,
        held_out: tuple[TrainingView, ...],
        random_points: int,
        save: Callable[[SplatState, float], None] | None,
        previews: Previews | None = None,
        draft: Callable[[SplatState, float], None] = lambda state, share: None,
        drafts_at: tuple[float, ...] = (),
    ) -> None:
        self._settings, self._progress, self._held_out, self._save = settings, progress, held_out, save
        self._random_points, self._previews = random_points, previews
        self._draft, self._drafts_at = draft, drafts_at
        self._losses: deque[float] = deque(maxlen=_MEAN_OF)
        self._psnr, self._speed = math.nan, 0.0
        self._reports: deque[tuple[int, float]] = deque(maxlen=_SPEED_OF)
        self._reported = self._saved = 0.0

    @property
    def loss(self) -> float | None:
        """Mean of the last 50 steps, or None before the first."""
        return sum(self._losses) / len(self._losses) if self._losses else None

    @property
    def preview_seconds(self) -> float:
        """What pictures of the run have taken."""
        return 0.0 if self._previews is None else self._previews.budget.spent_s

    def start(self, state: SplatState, elapsed_s: float, progress: float) -> None:
        """Before the first step."""
        self._reports.append((state.iteration, elapsed_s))
        self._reported = self._saved = time.monotonic()
        self.report(state, elapsed_s, progress)

    def observe_image(
        self, iteration: int, image: Tensor, target: Tensor, frame: Frame, correction: Tensor | None = None
    ) -> None:
        """Colors [H, W, 3] of a training step, what they are compared with, and the photo's correction [3], if any."""
        if not self._held_out and iteration % _PSNR_EVERY == 0 and frame.has_content:
            picture = image if correction is None else corrected_for(image, correction.detach(), target)
            self._psnr = psnr(picture, target, frame.valid)

    def after_step(self, state: SplatState, step: Step) -> None:
        """After a step and what densification made of it. What `progress` raises ends the run."""
        settings, now = self._settings, time.monotonic()
        self._losses.append(step.loss)
        if self._held_out and event_due(step.progress_before, step.progress, settings.evaluations):
            figures = measure_views(state.parameters, self._held_out, settings.backend, ("psnr",))
            self._psnr = figures.get("psnr", math.nan)
            release_free_memory()
            self._reported = -math.inf
        if now - self._reported >= _REPORT_EVERY_S:
            iteration, elapsed_s = self._reports[0]
            self._speed = (state.iteration - iteration) / max(step.elapsed_s - elapsed_s, 1e-9)
            self._reports.append((state.iteration, step.elapsed_s))
            self.report(state, step.elapsed_s, step.progress)
            self._reported = now
        if self._previews is not None:
            self._previews.after_step(
                state.parameters,
                step=state.iteration,
                elapsed_s=step.elapsed_s,
                degree=sh_degree(step.progress, settings),
                psnr=self._psnr,
            )
        if any(step.progress_before < share <= step.progress < 1 for share in self._drafts_at):
            self._draft(state, step.progress)
        if self._save and now - self._saved >= settings.checkpoint_every_s:
            self._save(state, step.elapsed_s)
            self._saved = now

    def finish(self, state: SplatState, elapsed_s: float) -> None:
        """After the last step."""
        if self._save:
            self._save(state, elapsed_s)

    def report(self, state: SplatState, elapsed_s: float, progress: float) -> None:
        """Sends one progress event."""
        metrics = {
            "iteration": float(state.iteration),
            "elapsed_s": elapsed_s,
            "gaussians": float(state.count),
            "iterations_per_second": self._speed,
            "random_points": float(self._random_points),
        }
        if self.loss is not None:
            metrics["loss"] = self.loss
        if math.isfinite(self._psnr):
            metrics["psnr"] = self._psnr
        message = f"iteration {state.iteration}, {state.count} Gaussians"
        self._progress(ProgressEvent("training", progress, message, metrics))
