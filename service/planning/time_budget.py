"""Division of `SceneOptions.time_budget_s` over perception, training and export.

It starts to count when poses are known, as the time of pose estimation cannot be predicted.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.planning.cost_model import Speed, fit_training, scene_size, views_within_budget
from fastsplat.service.planning.job_time import placed_seconds
from fastsplat.service.planning.machine import machine_speed, perception_cost
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.training_settings import TrainingSettings

S = TypeVar("S", PerceptionSettings, TrainingSettings)

_FEW_VIEWS = 3


@dataclass(frozen=True)
class StagePlan(Generic[S]):
    """Settings of a stage, and reductions due to the time budget, in words."""

    settings: S
    tradeoffs: tuple[str, ...] = ()


def plan_perception(
    capture: Capture,
    settings: Settings,
    labels: Sequence[str],
    time_budget_s: float | None,
    progress: Progress,
    *,
    started: float,
) -> StagePlan[PerceptionSettings]:
    """Plans perception; a budget, counted from `started` (monotonic), costs a trial view."""
    perception = settings.perception
    if time_budget_s is None or capture.given_labels is not None or len(capture.views) <= _FEW_VIEWS:
        return StagePlan(perception)
    progress(ProgressEvent("perception", 0.0, "labelling one view to measure the time it takes"))
    cost = perception_cost(capture, settings, labels, progress)
    views, tradeoffs = views_within_budget(
        perception.max_views, len(capture.views), time_budget_s, overhead_s=time.monotonic() - started, cost=cost
    )
    return StagePlan(perception.model_copy(update={"max_views": views}), tradeoffs)


def plan_training(
    capture: Capture,
    settings: Settings,
    labels: int,
    time_budget_s: float | None,
    *,
    spent_s: float,
    speed_of: Callable[[Backend], Speed] = machine_speed,
) -> StagePlan[TrainingSettings]:
    """Plans training within the budget; benchmarking by `speed_of` counts as spent."""
    if time_budget_s is None or capture.splat is not None:  # imported splats are not trained
        return StagePlan(settings.training)
    begun = time.monotonic()
    speed = speed_of(settings.training.backend)
    fitted = fit_training(
        settings.training,
        scene_size(capture, labels),
        time_budget_s,
        speed=speed,
        spent_s=spent_s + time.monotonic() - begun,
        tail_s=placed_seconds(capture, settings, settings.training, speed, labels)["export"],
    )
    return StagePlan(fitted.settings, fitted.tradeoffs)


def clock_tradeoff(
    requested: TrainingSettings, time_budget_s: float | None, quality: Mapping[str, float]
) -> tuple[str, ...]:
    """Tradeoff message if the requested time ended training before its minimum of steps."""
    fewest = min(requested.min_iterations, requested.iterations)
    steps = quality.get("iterations", math.inf)  # imported splats are not trained
    if time_budget_s is None or steps >= fewest or "stopped_at_share" in quality:
        return ()
    return (f"training ended by the time asked for, after {steps:.0f} steps in place of at least {fewest:,}",)


def with_tradeoffs(progress: Progress, tradeoffs: Sequence[str]) -> Progress:
    """Appends the tradeoffs to every progress message."""
    if not tradeoffs:
        return progress
    suffix = f" (to end in time: {', '.join(tradeoffs)})"
    return lambda event: progress(replace(event, message=event.message + suffix))
