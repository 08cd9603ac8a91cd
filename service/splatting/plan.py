"""A run planned to end in time: what it will cost on this machine, and what has to be given up for it.

The optimisation itself stops by the clock (`TrainingSettings.time_budget_s`), so what must be foreseen to the second is
only what comes before and after it; how fast a step is decides what is worth optimising in the time. All figures are
for the reference machine (2 CPU threads with AVX-512) and are divided by its `Speed`, which `service.splatting.probe`
measures.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from fastsplat.service.capture.types import Capture
from fastsplat.service.splatting.densify import planned_count
from fastsplat.service.splatting.schedule import image_level, image_scales
from fastsplat.service.splatting.semantics import code_size
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.thrift import JUDGES, MEASURES
from fastsplat.service.splatting.views import split_views
from fastsplat_contract.errors import InvalidInputError

_SHARES = 40  # points at which the cost of a step is taken along a run
_STEPS_A_VIEW, _FEWEST_STEPS, _ENOUGH_STEPS = 10, 250, 1_200
_SMALLEST_SIDE, _FEWEST_GAUSSIANS = 120, 2_000
_SIDE_RUNG, _GAUSSIANS_RUNG, _RUNGS = 0.84, 0.72, 14
_FLAT_FROM_RUNG = 4
_PERCEPTION_SHARE, _FEWEST_VIEWS = 0.4, 3
_LEAST_SHARE = 0.1  # of the budget is optimised, however little is left beside loading and writing


@dataclass(frozen=True)
class Speed:
    """Of a machine, in times the reference machine's: 0.5 takes twice as long.

    Attributes:
        steps: at drawing and differentiating, on all threads.
        serial: at everything else, which is done on one thread.
    """

    steps: float = 1.0
    serial: float = 1.0


@dataclass(frozen=True)
class SceneSize:
    """What of a capture decides how long it takes to train.

    Attributes:
        views: registered images.
        width, height: of the largest image, pixels.
        points: of the sparse reconstruction.
        labels: in the dictionary.
    """

    views: int
    width: int
    height: int
    points: int
    labels: int


_REFERENCE = Speed()


@dataclass(frozen=True)
class Plan:
    """What to train with, and what is expected of it.

    Attributes:
        settings: the run's; its `time_budget_s` are the seconds of optimisation that fit.
        seconds: expected for everything that the budget is for.
        parts: `seconds` by name: "spent", "load", "optimise", "finish" (measuring and writing), "tail".
        steps: optimisation steps that are expected to fit.
        given_up: what was asked for and will not be had, in words; empty when nothing was given up.
    """

    settings: TrainingSettings
    seconds: float
    parts: Mapping[str, float]
    steps: int
    given_up: tuple[str, ...] = field(default=())


def scene_size(capture: Capture, labels: int) -> SceneSize:
    """The size of a capture with `labels` entries in its dictionary."""
    cameras = [view.posed.camera for view in capture.views]
    return SceneSize(
        len(cameras),
        max((camera.width for camera in cameras), default=0),
        max((camera.height for camera in cameras), default=0),
        len(capture.points),
        labels,
    )


def plan_views(
    wanted: int, views: int, time_budget_s: float, *, overhead_s: float, view_s: float
) -> tuple[int, tuple[str, ...]]:
    """How many views perception may look at so that it takes no more than its share of the budget, 40 %.

    Args:
        wanted: views it would look at; 0 means all. views: that the capture has.
        time_budget_s: for everything from the start of perception on, seconds.
        overhead_s: seconds of perception that do not depend on the views, those already spent included.
        view_s: seconds a view.

    Returns:
        The number of views, 3 at least where there are so many; and what was given up, in words.
    """
    wanted = min(wanted or views, views)
    fit = math.floor((_PERCEPTION_SHARE * time_budget_s - overhead_s) / max(view_s, 1e-9))
    chosen = min(wanted, max(fit, _FEWEST_VIEWS))
    return chosen, (f"perception on {chosen} of {wanted} views",) if chosen < wanted else ()


def plan(
    settings: TrainingSettings,
    scene: SceneSize,
    time_budget_s: float,
    *,
    speed: Speed = _REFERENCE,
    spent_s: float = 0.0,
    tail_s: float = 0.0,
) -> Plan:
    """The best run that ends in time.

    The budget replaces `settings.time_budget_s`. Where the steps that fit are too few for the resolution and the number
    of Gaussians asked for, these are reduced together, along the measured frontier, until the steps are enough; the
    harmonics go once much else has gone. A budget larger than needed ends the run at `settings.iterations`.

    Args:
        settings: what is wanted: a preset, or the operator's own.
        scene: what is trained.
        time_budget_s: seconds for everything: what is spent already, the run, and what `tail_s` covers.
        speed: of this machine, as `service.splatting.probe.machine_speed` measures it.
        spent_s: seconds of the budget that are gone.
        tail_s: seconds that the caller needs after the run, on this machine.

    Raises:
        InvalidInputError: a budget or speed that is not positive, or negative seconds.
    """
    for name, value in (("time_budget_s", time_budget_s), ("steps", speed.steps), ("serial", speed.serial)):
        if not 0 < value < float("inf"):
            raise InvalidInputError(f"{name} of {value}", field=name, hint="Give a number above 0.")
    for name, value in (("spent_s", spent_s), ("tail_s", tail_s)):
        if not 0 <= value < float("inf"):
            raise InvalidInputError(f"{name} of {value}", field=name, hint="Give seconds, 0 or more.")
    wanted = min(settings.iterations, max(_FEWEST_STEPS, min(_ENOUGH_STEPS, _STEPS_A_VIEW * scene.views)))
    for rung in range(_RUNGS):
        chosen = _on_rung(settings, scene, rung)
        load = load_seconds(scene) / speed.serial
        finish = judge_seconds(chosen, scene) / speed.steps + write_seconds(chosen) / speed.serial
        left = time_budget_s - spent_s - load - finish - tail_s
        rate = steps_per_second(chosen, scene) * speed.steps
        if rate * left >= wanted:
            break
    optimise = max(left, _LEAST_SHARE * time_budget_s)
    steps = min(settings.iterations, max(1, int(rate * optimise)))
    chosen = chosen.model_copy(update={"time_budget_s": optimise})
    optimised = min(optimise, settings.iterations / rate)
    parts = {"spent": spent_s, "load": load, "optimise": optimised, "finish": finish, "tail": tail_s}
    seconds = sum(parts.values())
    return Plan(chosen, seconds, parts, steps, _given_up(settings, chosen, scene, time_budget_s, seconds))


def step_seconds(pixels: int, gaussians: int, channels: int) -> float:
    """One optimisation step on the reference machine.

    Fitted to 15 pairs of image size and number of Gaussians of the table-top benchmark, within 20 %: Gaussians are
    projected and updated, pixels are compared, and what a pixel blends grows with the number of Gaussians to the 0.8.

    Args:
        pixels: of the image. gaussians: in use. channels: of the code.
    """
    blended = 1.09e-4 * pixels + 4.05e-8 * pixels * math.pow(gaussians, 0.8)
    return 1e-3 * (1.8 + 1.9e-4 * gaussians + blended * (0.8 + 0.025 * channels))


def steps_per_second(settings: TrainingSettings, scene: SceneSize) -> float:
    """Mean over a run of `settings`, bounded by time, on the reference machine; schedules as in training."""
    start = max(1, min(scene.points, settings.max_gaussians))
    width, height = _size(settings, scene)
    scales = image_scales(settings)
    channels = 0 if settings.label_mode == "evidence" else code_size(scene.labels, settings.code_size)
    rates = []
    for index in range(_SHARES):
        share = (index + 0.5) / _SHARES
        count = planned_count(share, start, settings.max_gaussians, settings.densify_from, settings.full_count_at)
        pixels = width * height * scales[image_level(share, settings)] ** 2
        rates.append(1 / step_seconds(round(pixels), count, channels))
    return sum(rates) / len(rates)


def load_seconds(scene: SceneSize) -> float:
    """Everything before the first step: images decoded and reduced, Gaussians placed, codes spread."""
    pixels = scene.width * scene.height
    return 0.1 + scene.views * (0.002 + 2.5e-8 * pixels) + 2e-6 * scene.points + (0.2 if scene.labels else 0.0)


def write_seconds(settings: TrainingSettings) -> float:
    """The last checkpoint and the result, gathered and written."""
    return 0.1 + 5e-6 * settings.max_gaussians


def judge_seconds(settings: TrainingSettings, scene: SceneSize) -> float:
    """What is drawn after the last step: for thrift, for evidence, and the held-out views to be measured."""
    width, height = _size(settings, scene)
    held_out = len(split_views(scene.views, settings.held_out_every)[1])
    step = step_seconds(round(width * height), settings.max_gaussians, 0)
    measured, thrift = 0.4 * step, 0.0
    evidence = 0.8 * step * scene.views if settings.label_mode == "evidence" and scene.labels else 0.0
    if settings.surplus_loss_db and held_out:
        small = round(width * height * image_scales(settings)[0] ** 2)
        weighed = scene.views * 0.4 * step_seconds(small, settings.max_gaussians, 0)
        thrift = weighed + MEASURES * min(held_out, JUDGES) * measured
    return held_out * measured + thrift + evidence


def _on_rung(settings: TrainingSettings, scene: SceneSize, rung: int) -> TrainingSettings:
    if rung == 0:
        return settings
    longest = min(settings.max_side, max(scene.width, scene.height, 1))
    side = max(min(longest, _SMALLEST_SIDE), round(longest * _SIDE_RUNG**rung / 8) * 8)
    least = min(settings.max_gaussians, _FEWEST_GAUSSIANS)
    count = max(least, _round_number(settings.max_gaussians * _GAUSSIANS_RUNG**rung))
    degree = settings.max_sh_degree if rung < _FLAT_FROM_RUNG else 0
    return settings.model_copy(update={"max_side": side, "max_gaussians": count, "max_sh_degree": degree})


def _round_number(value: float) -> int:
    """Two significant digits."""
    return int(float(f"{value:.1e}"))


def _size(settings: TrainingSettings, scene: SceneSize) -> tuple[float, float]:
    factor = min(1.0, settings.max_side / max(scene.width, scene.height, 1))
    return scene.width * factor, scene.height * factor


def _given_up(
    wanted: TrainingSettings, chosen: TrainingSettings, scene: SceneSize, budget: float, seconds: float
) -> tuple[str, ...]:
    side = min(wanted.max_side, max(scene.width, scene.height))
    lost = []
    if chosen.max_side < side:
        lost.append(f"resolution {side} → {chosen.max_side} px")
    if chosen.max_gaussians < wanted.max_gaussians:
        lost.append(f"Gaussians {wanted.max_gaussians:,} → {chosen.max_gaussians:,}")
    if chosen.max_sh_degree < wanted.max_sh_degree:
        lost.append(f"harmonics degree {wanted.max_sh_degree} → {chosen.max_sh_degree}")
    if wanted.time_budget_s is not None and (chosen.time_budget_s or 0) < wanted.time_budget_s:
        lost.append(f"optimisation {wanted.time_budget_s:.3g} → {chosen.time_budget_s:.3g} s")
    if seconds > 1.1 * budget:
        lost.append(f"the time budget itself: {budget:.3g} s → {seconds:.2g} s, the least that this capture takes")
    return tuple(lost)
