"""A job's time budget: what perception and training get of it. Decided once a job, whichever attempt runs it.

`SceneOptions.time_budget_s` covers everything after the capture stage: perception, training and export. (How long poses
take to find cannot be foreseen; they are there, or not, when the budget starts to count.)
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass, replace

from fastsplat.service.capture.types import Capture
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.perception import label_capture
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.splatting.plan import plan, plan_views, scene_size
from fastsplat.service.splatting.presets import PERCEPTION_PRESETS, with_preset
from fastsplat.service.splatting.probe import machine_speed
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.workers.protocol import Job
from fastsplat.workers.results import stage_seconds

_SEARCH_SHARE = 1.2  # of what cutting out takes, for the search before it
_FEW_VIEWS = 3
_PLAN = "plan.json"


@dataclass(frozen=True)
class TrainingPlan:
    """What a job trains with, and what it gave up to end in time."""

    settings: TrainingSettings
    given_up: tuple[str, ...] = ()


def plan_perception(
    job: Job, capture: Capture, started: float, progress: Progress
) -> tuple[PerceptionSettings, tuple[str, ...]]:
    """What perception looks with, and what it gave up; one view is tried where a detector will run.

    Args:
        job, capture: what is labelled.
        started: `time.monotonic()` when the budget began to count.
        progress: see `label_capture`.
    """
    preset, budget = job.options.preset, job.options.time_budget_s
    settings = job.settings.perception
    if preset is not None:
        settings = settings.model_copy(update=dict(PERCEPTION_PRESETS[preset]))
    if budget is None or capture.given_labels is not None or len(capture.views) <= _FEW_VIEWS:
        return settings, ()
    progress(ProgressEvent("perception", 0.0, "trying one view"))
    overhead, view = _probe_perception(job, capture, settings, progress)
    spent = time.monotonic() - started
    views, given_up = plan_views(
        settings.max_views, len(capture.views), budget, overhead_s=spent + overhead, view_s=view
    )
    return settings.model_copy(update={"max_views": views}), given_up


def plan_training(job: Job, capture: Capture, labels: int, started: float) -> TrainingPlan:
    """What training trains with: an earlier attempt's plan if there is one, for its checkpoints continue.

    Args:
        job, capture: what is trained. labels: entries of its dictionary.
        started: `time.monotonic()` at the start of the training stage.
    """
    budget = job.options.time_budget_s
    if budget is not None and not (job.folder / _PLAN).exists():
        wanted = _wanted(job)
        speed = machine_speed(wanted.backend)
        spent = stage_seconds(job, "perception") + time.monotonic() - started
        tail = _export_seconds(labels) / speed.serial
        found = plan(wanted, scene_size(capture, labels), budget, speed=speed, spent_s=spent, tail_s=tail)
        _keep(job, TrainingPlan(found.settings, found.given_up))
    return kept_plan(job)


def kept_plan(job: Job) -> TrainingPlan:
    """What the training stage trains or trained with."""
    if not (job.folder / _PLAN).exists():  # without a time budget there is nothing to plan
        return TrainingPlan(_wanted(job))
    stored = json.loads((job.folder / _PLAN).read_text())
    return TrainingPlan(TrainingSettings.model_validate(stored["settings"]), tuple(stored["given_up"]))


def _wanted(job: Job) -> TrainingSettings:
    wanted = with_preset(job.settings.training, job.options.preset)
    if job.options.max_gaussians is None:
        return wanted
    return wanted.model_copy(update={"max_gaussians": job.options.max_gaussians})


def _probe_perception(
    job: Job, capture: Capture, settings: PerceptionSettings, progress: Progress
) -> tuple[float, float]:
    """Seconds that do not depend on the views, and seconds a view: from one view in the middle."""
    middle = len(capture.views) // 2
    one = replace(capture, views=capture.views[middle : middle + 1])
    times: list[float] = []

    def listen(event: ProgressEvent) -> None:
        times.append(time.monotonic())
        progress(replace(event, fraction=0.0))

    begun = time.monotonic()
    label_capture(one, settings, job.settings.models, job.options.labels, listen)
    total = time.monotonic() - begun
    # The last word tells of a view cut out, the one before of a view searched, after models were loaded.
    view = _SEARCH_SHARE * (times[-1] - times[-2])
    return max(0.0, total - view), view


def _export_seconds(labels: int) -> float:
    """Embedding the dictionary and writing the scene, on the reference machine."""
    return 1.0 + 0.01 * labels


def _keep(job: Job, made: TrainingPlan) -> None:
    """Write the plan unless another attempt was faster; whole or not at all."""
    part = job.folder / f"{_PLAN}.{job.attempt}.part"
    part.write_text(json.dumps({"settings": made.settings.model_dump(mode="json"), "given_up": made.given_up}))
    try:
        os.link(part, job.folder / _PLAN)
    except FileExistsError:
        pass
    finally:
        part.unlink()
