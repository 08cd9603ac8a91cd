"""Small pictures of a scene while it is trained, for at most a few percent of the training's time."""

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
from fastsplat.service.splatting.objective import render_frame
from fastsplat.service.splatting.raster.types import Backend
from fastsplat.service.splatting.training_views import TrainingView, training_size
from fastsplat.service.splatting.types import TrainedSplats

PREVIEW_SHARE = 0.03
"""Of the training's time, for pictures."""
_SIDE = 320
_JPEG_QUALITY = 80
_GROWTH = 1.25
"""A picture comes once the training has lasted so many times as long as at the one before: dense at first."""
_FIRST_GAP_S, _LONGEST_GAP_S = 1.0, 30.0


@dataclass(frozen=True)
class TrainingPreview:
    """A rendering of one of the training views.

    Attributes:
        jpeg: of at most 320 pixels on the longer side.
        step: optimization steps behind it.
        seconds: of optimization behind it.
        psnr: dB, as measured last; None before the first time.
        width, height: pixels.
    """

    jpeg: bytes
    step: int
    seconds: float
    gaussians: int
    psnr: float | None
    view: str
    width: int
    height: int


def _never() -> bool:
    return False


@dataclass(frozen=True)
class TrainingWatch:
    """Who follows a training, and may end it.

    Attributes:
        show: is given pictures of it; None for no pictures.
        finish: whether to end it early; asked after every step.
        draft: is given the scene as it is under way, with the share of the run behind it; what it takes counts as
            training.
        drafts_at: after which shares of the run, 0..1.
    """

    show: Callable[[TrainingPreview], None] | None = None
    finish: Callable[[], bool] = _never
    draft: Callable[[TrainedSplats, float], None] = lambda splats, share: None
    drafts_at: tuple[float, ...] = ()


UNWATCHED = TrainingWatch()
"""Nobody follows."""


class PreviewBudget:
    """Says when a picture is due: the first at once, the second when the first is paid for, then ever more seldom, and
    never so that all would take more than `PREVIEW_SHARE` of the time. The next one is expected to cost what the last
    one did."""

    def __init__(self) -> None:
        self._spent_s = self._last_cost_s = 0.0
        self._last_at: float | None = None

    def is_due(self, elapsed_s: float) -> bool:
        """Whether to make one, `elapsed_s` seconds after the start."""
        if self._last_at is None:
            return True
        gap = min(max(_FIRST_GAP_S, (_GROWTH - 1) * self._last_at), _LONGEST_GAP_S)
        affordable = self._spent_s + self._last_cost_s <= PREVIEW_SHARE * elapsed_s
        return affordable and elapsed_s - self._last_at >= gap

    def spend(self, elapsed_s: float, cost_s: float) -> None:
        """Note that one was made `elapsed_s` seconds after the start, and what it took."""
        self._last_at, self._last_cost_s = elapsed_s, cost_s
        self._spent_s += cost_s

    @property
    def spent_s(self) -> float:
        """Seconds that all pictures have taken."""
        return self._spent_s


class Previews:
    """Takes pictures of a run with one of its training views, and hands them on.

    Args:
        view: from which.
        publish: is given each picture; what it takes is counted too.
    """

    def __init__(self, view: TrainingView, backend: Backend, publish: Callable[[TrainingPreview], None]) -> None:
        camera = training_size(view.frames[-1].camera, _SIDE)
        self._view, self._frame = view, replace(view.frames[-1], camera=camera)
        self._backend, self._publish = backend, publish
        self._budget = PreviewBudget()
        self._started = time.monotonic()

    def after_step(
        self, parameters: dict[str, Tensor], *, step: int, elapsed_s: float, degree: int, psnr: float
    ) -> None:
        """Take a picture if one is due.

        Args:
            parameters: see `SplatState`.
            psnr: dB; NaN if it is not known.
        """
        begun = time.monotonic()
        if not self._budget.is_due(begun - self._started):
            return
        camera = self._frame.camera
        jpeg = _jpeg(self._render(parameters, degree))
        gaussians = len(parameters["means"])
        known = psnr if math.isfinite(psnr) else None
        view = self._view.name
        self._publish(TrainingPreview(jpeg, step, elapsed_s, gaussians, known, view, camera.width, camera.height))
        now = time.monotonic()
        self._budget.spend(now - self._started, now - begun)

    @property
    def spent_s(self) -> float:
        """Seconds that all pictures have taken so far."""
        return self._budget.spent_s

    @torch.no_grad()
    def _render(self, parameters: dict[str, Tensor], degree: int) -> Tensor:
        splats = splats_of(parameters)
        return render_frame(parameters, splats, self._view, self._frame, degree=degree, backend=self._backend).image


def _jpeg(image: Tensor) -> bytes:
    pixels = (image.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()
    _, content = cv2.imencode(
        ".jpg", np.ascontiguousarray(pixels[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    )
    return content.tobytes()
