"""Renders preview images during training within a small share of its time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from torch import Tensor

from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training_views import TrainingView, render_frame, training_size

PREVIEW_SHARE = 0.03
"""Maximum share of training time spent on previews."""
_SIDE = 320
_JPEG_QUALITY = 80
_GROWTH = 1.25  # factor of elapsed time between pictures: frequent at first
_FIRST_GAP_S, _LONGEST_GAP_S = 1.0, 30.0


@dataclass(frozen=True)
class TrainingPreview:
    """A rendering of a training view."""

    jpeg: bytes  # at most 320 pixels on the longer side
    step: int  # optimization steps so far
    seconds: float  # of optimization so far
    gaussians: int
    psnr: float | None  # last measurement, dB
    view: str
    width: int
    height: int


@dataclass(frozen=True)
class TrainingWatch:
    """Callbacks that observe a training run and may end it.

    Attributes:
        show: receives previews.
        finish: polled after every step; True ends the run early.
        draft: receives the current scene and the progress 0..1; its duration counts as training.
        drafts_at: progress values for drafts.
    """

    show: Callable[[TrainingPreview], None] | None = None
    finish: Callable[[], bool] = lambda: False
    draft: Callable[[TrainedSplats, float], None] = lambda splats, share: None
    drafts_at: tuple[float, ...] = ()


UNWATCHED = TrainingWatch()
"""No callbacks."""


class PreviewBudget:
    """Schedules previews within `PREVIEW_SHARE` of the time, at growing intervals.

    The first comes at once; each next one is assumed to cost as much as the last. `spent_s` is the total, seconds.
    """

    def __init__(self) -> None:
        self.spent_s = self._last_cost_s = 0.0
        self._last_at: float | None = None

    def is_due(self, elapsed_s: float) -> bool:
        """Tests if a preview is due `elapsed_s` seconds after the start."""
        if self._last_at is None:
            return True
        gap = min(max(_FIRST_GAP_S, (_GROWTH - 1) * self._last_at), _LONGEST_GAP_S)
        affordable = self.spent_s + self._last_cost_s <= PREVIEW_SHARE * elapsed_s
        return affordable and elapsed_s - self._last_at >= gap

    def spend(self, elapsed_s: float, cost_s: float) -> None:
        """Records the cost of a preview made `elapsed_s` seconds after the start."""
        self._last_at, self._last_cost_s = elapsed_s, cost_s
        self.spent_s += cost_s


class Previews:
    """Renders previews of `view` and passes them to `publish`, whose time counts too."""

    def __init__(self, view: TrainingView, backend: Backend, publish: Callable[[TrainingPreview], None]) -> None:
        camera = training_size(view.frames[-1].camera, _SIDE)
        self._view, self._frame = view, replace(view.frames[-1], camera=camera)
        self._backend, self._publish = backend, publish
        self.budget = PreviewBudget()
        self._started = time.monotonic()

    def after_step(
        self, parameters: dict[str, Tensor], *, step: int, elapsed_s: float, degree: int, psnr: float
    ) -> None:
        """Renders a preview if one is due; an unknown `psnr` is NaN."""
        begun = time.monotonic()
        if not self.budget.is_due(begun - self._started):
            return
        camera = self._frame.camera
        with torch.no_grad():
            splats, backend = splats_of(parameters), self._backend
            drawn = render_frame(parameters, splats, self._view, self._frame, degree=degree, backend=backend)
        jpeg = _jpeg(drawn.image)
        gaussians = len(parameters["means"])
        known = psnr if math.isfinite(psnr) else None
        view = self._view.name
        self._publish(TrainingPreview(jpeg, step, elapsed_s, gaussians, known, view, camera.width, camera.height))
        now = time.monotonic()
        self.budget.spend(now - self._started, now - begun)


def _jpeg(image: Tensor) -> bytes:
    pixels = (image.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()
    _, content = cv2.imencode(
        ".jpg", np.ascontiguousarray(pixels[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    )
    return content.tobytes()
