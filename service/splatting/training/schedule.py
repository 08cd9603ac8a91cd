"""Every schedule of a run, as a function of its progress 0..1; so bounds in time and in steps need one code."""

from __future__ import annotations

import math

from fastsplat.service.splatting.training_settings import TrainingSettings


def run_progress(iteration: int, elapsed_s: float, settings: TrainingSettings) -> float:
    """0 at the start, 1 when the first of the two bounds is reached; the clock's only after `min_iterations`."""
    progress = iteration / settings.iterations
    if settings.time_budget_s is not None:
        clock = elapsed_s / settings.time_budget_s
        if settings.min_iterations:
            clock = min(clock, iteration / settings.min_iterations)
        progress = max(progress, clock)
    return min(progress, 1.0)


def image_scales(settings: TrainingSettings) -> tuple[float, ...]:
    """Image sizes of a run, as shares of the training size, ascending; the last is 1."""
    start = settings.start_scale
    return (1.0,) if start == 1 else (start, math.sqrt(start), 1.0)


def image_level(progress: float, settings: TrainingSettings) -> int:
    """Index into `image_scales`: the first two sizes each last half of the time until `full_size_from`."""
    levels = len(image_scales(settings))
    if progress >= settings.full_size_from:
        return levels - 1
    return min(int(progress / settings.full_size_from * (levels - 1)), levels - 1)


def sh_degree(progress: float, settings: TrainingSettings) -> int:
    """Spherical-harmonics degree in use."""
    return min(settings.max_sh_degree, sum(progress >= start for start in settings.sh_from))


def learning_rates(progress: float, extent: float, settings: TrainingSettings) -> dict[str, float]:
    """Adam's learning rate of each parameter of `SplatState`."""
    rates = settings.rates
    decay = rates.final_share**progress
    return {
        "means": extent * rates.means * (rates.means_final / rates.means) ** progress,
        "quats": rates.quats * decay,
        "log_scales": rates.log_scales * decay,
        "logit_opacities": rates.logit_opacities * decay,
        "sh_dc": rates.sh_dc * decay,
        "sh_rest": rates.sh_dc * rates.sh_rest_share * decay,
        "codes": rates.codes * decay,
        "weight": rates.weight * decay,
        "bias": rates.weight * decay,
    }


def event_due(before: float, now: float, events: int) -> bool:
    """Whether one of `events` evenly spaced moments of a run lies in (before, now]."""
    return math.floor(now * events) > math.floor(before * events)


def depth_regularized(iteration: int, progress: float, settings: TrainingSettings, measured: bool = False) -> bool:
    """Whether the terms of `depth_regularization` and `.sensor_depth` enter the loss of a step;
    the latter only where the depth of the frame was `measured`.

    The last of every `depth_every` steps, because the cross-entropy has the first of every `semantic_every`.
    """
    weights = (
        settings.depth_spread_weight,
        settings.depth_smoothness_weight,
        settings.depth_anchor_weight,
        measured and settings.sensor_depth_weight,
    )
    due = iteration % settings.depth_every == settings.depth_every - 1
    return any(weights) and progress >= settings.depth_from and due
