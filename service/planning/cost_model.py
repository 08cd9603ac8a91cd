"""Cost model of training runs, and settings that fit a time budget.

Training stops by the clock; the other stages and the step time, which decides resolution and number of Gaussians, are
predicted. Seconds are of the reference machine (2 CPU threads with AVX-512), divided by `Speed`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import mean

from fastsplat.service.capture.captures import Capture
from fastsplat.service.splatting.labels.semantics import code_size
from fastsplat.service.splatting.training.densify import planned_count
from fastsplat.service.splatting.training.pruning import MAX_EVAL_VIEWS
from fastsplat.service.splatting.training.schedule import image_level, image_scales
from fastsplat.service.splatting.training_settings import FEWEST_STEPS, TrainingSettings
from fastsplat.service.splatting.training_views import split_views
from fastsplat_contract.errors import InvalidInputError

_SHARES = 40  # samples of the step cost along a run
_STEPS_A_VIEW, _ENOUGH_STEPS = 10, 1_200
_SMALLEST_SIDE, _FEWEST_GAUSSIANS = 120, 2_000
_SIDE_FACTOR, _GAUSSIANS_FACTOR, _LEVELS = 0.84, 0.72, 14  # per level of reduction
_PERCEPTION_SHARE, _FEWEST_VIEWS = 0.4, 3
_DRAWN_A_VIEW = 6  # in training steps
_JUDGED = 5  # measurements of some views after the last step: of the scene, and of each degree of harmonics
_BELIEVED = 0.05
_LEAST_SHARE = 0.1  # of the budget for optimization, however long loading and writing take


@dataclass(frozen=True)
class Speed:
    """Speed factors against the reference machine; only `serial` work uses a single thread."""

    steps: float = 1.0
    serial: float = 1.0
    networks: float = 1.0

    def slowed(self, times: float) -> Speed:
        """Returns the speed of a machine on which everything takes `times` as long."""
        return Speed(self.steps / times, self.serial / times, self.networks / times)


@dataclass(frozen=True)
class SceneSize:
    """Scene size: images, pixels of the largest, sparse points, labels learned as codes."""

    views: int
    width: int
    height: int
    points: int
    labels: int


@dataclass(frozen=True)
class PerceptionCost:
    """Seconds to load models, search a view and segment one of `segmented` views (0: all)."""

    overhead_s: float
    search_s: float
    segment_s: float
    segmented: int = 0

    def seconds(self, views: int) -> float:
        """Total seconds for a number of views."""
        return self.overhead_s + self.search_s * views + self.segment_s * min(views, self.segmented or views)


_REFERENCE = Speed()


@dataclass(frozen=True)
class TrainingPlan:
    """Training settings that fit a budget, with predicted cost.

    Attributes:
        settings: `time_budget_s` holds the seconds of optimization that fit.
        seconds: sum of `parts`: spent, load, optimize, finish (measure, write), tail.
        tradeoffs: reductions against the requested settings, in words.
    """

    settings: TrainingSettings
    seconds: float
    parts: Mapping[str, float]
    steps: int
    tradeoffs: tuple[str, ...] = field(default=())


def scene_size(capture: Capture, labels: int) -> SceneSize:
    """Size of a capture whose dictionary has `labels` entries."""
    cameras = [view.posed.camera for view in capture.views]
    return SceneSize(
        len(cameras),
        max((camera.width for camera in cameras), default=0),
        max((camera.height for camera in cameras), default=0),
        len(capture.points),
        labels if capture.given_labels is not None else 0,
    )


def views_within_budget(
    requested: int, views: int, time_budget_s: float, *, overhead_s: float, cost: PerceptionCost
) -> tuple[int, tuple[str, ...]]:
    """Number of views for perception within 40 % of the budget, and tradeoffs.

    `requested` 0 is all; 3 are kept if there are as many. `overhead_s` of the budget, which counts from the start of
    perception, are already spent.
    """
    requested = min(requested or views, views)
    bound = _PERCEPTION_SHARE * time_budget_s - overhead_s
    fit = next((count for count in range(requested, 0, -1) if cost.seconds(count) <= bound), 0)
    count = min(requested, max(fit, _FEWEST_VIEWS))
    return count, (f"perception on {count} of {requested} views",) if count < requested else ()


def fit_training(
    settings: TrainingSettings,
    scene: SceneSize,
    time_budget_s: float,
    *,
    speed: Speed = _REFERENCE,
    spent_s: float = 0.0,
    tail_s: float = 0.0,
) -> TrainingPlan:
    """Best run that ends within the budget, which replaces `settings.time_budget_s`.

    Unless 10 steps a view (`FEWEST_STEPS` to 1,200) fit, resolution and number of Gaussians are reduced together along
    the measured frontier; spherical harmonics stay. The budget covers `spent_s`, the run, and `tail_s` after it.

    Raises:
        InvalidInputError: a budget or speed that is not positive, or negative seconds.
    """
    for name, value in (("time_budget_s", time_budget_s), ("steps", speed.steps), ("serial", speed.serial)):
        if not 0 < value < float("inf"):
            raise InvalidInputError(f"{name} of {value}", field=name, hint="Give a number above 0.")
    for name, value in (("spent_s", spent_s), ("tail_s", tail_s)):
        if not 0 <= value < float("inf"):
            raise InvalidInputError(f"{name} of {value}", field=name, hint="Give seconds, 0 or more.")
    enough_steps = min(settings.iterations, max(FEWEST_STEPS, min(_ENOUGH_STEPS, _STEPS_A_VIEW * scene.views)))
    for level in range(_LEVELS):
        reduced = _at_level(settings, scene, level)
        load = load_seconds(scene) / speed.serial
        finish = measure_seconds(reduced, scene) / speed.steps + write_seconds(reduced) / speed.serial
        left = time_budget_s - spent_s - load - finish - tail_s
        rate = steps_per_second(reduced, scene) * speed.steps
        if rate * left >= enough_steps:
            break
    optimize = max(left, _LEAST_SHARE * time_budget_s)
    reduced = reduced.ending_after(optimize)
    optimized, steps = _optimized(reduced, scene, speed)
    parts = {"spent": spent_s, "load": load, "optimize": optimized, "finish": finish, "tail": tail_s}
    seconds = sum(parts.values())
    return TrainingPlan(reduced, seconds, parts, steps, _tradeoffs(settings, reduced, scene, time_budget_s, seconds))


def run_seconds(settings: TrainingSettings, scene: SceneSize, speed: Speed = _REFERENCE) -> float:
    """Predicted seconds of a whole run: loading, optimization, measuring and writing."""
    optimize, _ = _optimized(settings, scene, speed)
    return load_seconds(scene) / speed.serial + optimize + finish_seconds(settings, scene, speed)


def _optimized(settings: TrainingSettings, scene: SceneSize, speed: Speed) -> tuple[float, int]:
    """Seconds and steps until a run reaches a bound, see `schedule.run_progress`."""
    mean_s = mean(_steps_of_run(settings, scene)) / speed.steps
    clock_s, bound = settings.time_budget_s, settings.iterations
    if clock_s is None or bound * mean_s <= clock_s:
        return bound * mean_s, bound
    least = min(settings.min_iterations, bound)
    if least * mean_s > clock_s:
        return least * mean_s, least
    return clock_s, min(bound, max(1, int(steps_per_second(settings, scene) * speed.steps * clock_s)))


def run_seconds_left(
    settings: TrainingSettings, scene: SceneSize, speed: Speed, iteration: int, elapsed_s: float
) -> float:
    """Seconds until a run is written; the prediction weighs like 5 % of it."""
    steps = _steps_of_run(settings, scene)

    def until(bound: int) -> float:
        whole, at = bound * mean(steps), min(iteration / bound, 1.0) * _SHARES
        done = bound / _SHARES * (sum(steps[: int(at)]) + at % 1 * steps[min(int(at), _SHARES - 1)])
        return (whole - done) * (elapsed_s + _BELIEVED * whole / speed.steps) / (done + _BELIEVED * whole)

    left, least = until(settings.iterations), min(settings.min_iterations, settings.iterations)
    if settings.time_budget_s is not None:
        left = min(left, max(settings.time_budget_s - elapsed_s, until(least) if least else 0.0, 0.0))
    return left + finish_seconds(settings, scene, speed)


def finish_seconds(settings: TrainingSettings, scene: SceneSize, speed: Speed = _REFERENCE) -> float:
    """Seconds after the last training step: measuring and writing."""
    return measure_seconds(settings, scene) / speed.steps + write_seconds(settings) / speed.serial


def step_seconds(pixels: int, gaussians: int, channels: int, sh_degree: int = 1) -> float:
    """Seconds of one optimization step on the reference machine."""
    # Fitted within 20 % to 15 pairs of image size and Gaussian count (table-top benchmark); blending ~ count^0.8. Then
    # scaled to 31 % (29 to 34 by size) as kernels became faster, by the steps of `benchmarks.training`.
    blended = 1.09e-4 * pixels + 4.05e-8 * pixels * math.pow(gaussians, 0.8)
    harmonics = 5e-6 * ((sh_degree + 1) ** 2 - 4)
    return 3.1e-4 * (1.8 + (1.9e-4 + harmonics) * gaussians + blended * (0.8 + 0.025 * channels))


def steps_per_second(settings: TrainingSettings, scene: SceneSize) -> float:
    """Mean step rate of a time-bounded run on the reference machine."""
    return mean(1 / seconds for seconds in _steps_of_run(settings, scene))


def _steps_of_run(settings: TrainingSettings, scene: SceneSize) -> list[float]:
    """Seconds per step at evenly spaced shares of a run."""
    start = max(1, min(scene.points, settings.max_gaussians))
    width, height = _size(settings, scene)
    scales = image_scales(settings)
    channels = 0 if settings.label_mode == "evidence" else code_size(scene.labels, settings.code_size)
    steps = []
    for index in range(_SHARES):
        share = (index + 0.5) / _SHARES
        count = planned_count(share, start, settings.max_gaussians, settings.densify_from, settings.full_count_at)
        pixels = width * height * scales[image_level(share, settings)] ** 2
        steps.append(step_seconds(round(pixels), count, channels, settings.max_sh_degree))
    return steps


def load_seconds(scene: SceneSize) -> float:
    """Seconds before the first step: decoding, downscaling, initialization of Gaussians and codes."""
    pixels = scene.width * scene.height
    return 0.1 + scene.views * (0.002 + 2.5e-8 * pixels) + 2e-6 * scene.points + (0.2 if scene.labels else 0.0)


def write_seconds(settings: TrainingSettings) -> float:
    """Seconds to gather and write the last checkpoint and the result."""
    return 0.1 + 5e-6 * settings.max_gaussians


def measure_seconds(settings: TrainingSettings, scene: SceneSize) -> float:
    """Seconds of rendering after the last step: harmonics, label evidence, label refit, held-out views."""
    width, height = _size(settings, scene)
    held_out = len(split_views(scene.views, settings.held_out_every)[1])
    step = step_seconds(round(width * height), settings.max_gaussians, 0)
    evidence = 0.8 * step * scene.views if settings.label_mode == "evidence" and scene.labels else 0.0
    judged = _JUDGED * min(held_out or scene.views, MAX_EVAL_VIEWS) if settings.tolerance_db else 0
    refit = 0.0
    if settings.label_mode != "evidence" and scene.labels and settings.label_refit_epochs:
        channels = code_size(scene.labels, settings.code_size)
        looked = 0.8 * step_seconds(round(width * height), settings.max_gaussians, channels)
        refit = scene.views * (0.8 * step + settings.label_refit_epochs * looked)
    return (held_out + judged) * 0.4 * step + evidence + refit


def export_seconds(
    settings: TrainingSettings, scene: SceneSize, labels: int, views: int, proposed: int, speed: Speed
) -> float:
    """Seconds of the export stage; `proposed` of the `views` need mask proposals first."""
    written = (1.0 + 0.01 * labels) / speed.serial
    if not views:
        return written
    width, height = _size(settings, scene)
    drawn = _DRAWN_A_VIEW * step_seconds(round(width * height), settings.max_gaussians, 0) / speed.steps
    return written + (1.3 + 0.2 * views) / speed.serial + views * drawn + 1.5 * proposed / speed.networks


def _at_level(settings: TrainingSettings, scene: SceneSize, level: int) -> TrainingSettings:
    if level == 0:
        return settings
    longest = min(settings.max_side, max(scene.width, scene.height, 1))
    side = max(min(longest, _SMALLEST_SIDE), round(longest * _SIDE_FACTOR**level / 8) * 8)
    least = min(settings.max_gaussians, _FEWEST_GAUSSIANS)
    two_digits = int(float(f"{settings.max_gaussians * _GAUSSIANS_FACTOR**level:.1e}"))
    return settings.model_copy(update={"max_side": side, "max_gaussians": max(least, two_digits)})


def _size(settings: TrainingSettings, scene: SceneSize) -> tuple[float, float]:
    factor = min(1.0, settings.max_side / max(scene.width, scene.height, 1))
    return scene.width * factor, scene.height * factor


def _tradeoffs(
    requested: TrainingSettings, reduced: TrainingSettings, scene: SceneSize, budget: float, seconds: float
) -> tuple[str, ...]:
    side = min(requested.max_side, max(scene.width, scene.height))
    lines = []
    if reduced.max_side < side:
        lines.append(f"resolution {side} → {reduced.max_side} px")
    if reduced.max_gaussians < requested.max_gaussians:
        lines.append(f"Gaussians {requested.max_gaussians:,} → {reduced.max_gaussians:,}")
    if requested.time_budget_s is not None and (reduced.time_budget_s or 0) < requested.time_budget_s:
        lines.append(f"optimization {requested.time_budget_s:.3g} → {reduced.time_budget_s:.3g} s")
    if seconds > 1.1 * budget:
        lines.append(f"the time budget itself: {budget:.3g} s → {seconds:.2g} s, the least that this capture takes")
    return tuple(lines)
