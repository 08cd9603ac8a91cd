"""Training plan of a job and speed of its machine, on disk: each is found once, by the attempt that comes first.

Checkpoints continue a plan, and to measure a speed takes a second.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import asdict

from fastsplat.service.capture.types import Capture
from fastsplat.service.planning.cost_model import Speed
from fastsplat.service.planning.machine import machine_speed
from fastsplat.service.planning.time_budget import StagePlan, plan_training
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.workers.protocol import Job
from fastsplat.workers.results import intact, stage_seconds

_PLAN = "plan.json"


def job_speed(job: Job) -> Speed:
    """The speed of the machine that asked first for this job."""
    path = job.folder / "speed.json"
    if path.exists():
        return Speed(**json.loads(path.read_text()))
    speed = machine_speed(job.settings.training.backend)
    part = job.folder / f"speed.json.{job.attempt}.part"
    part.write_text(json.dumps(asdict(speed)))
    os.replace(part, path)
    return speed


def make_plan(job: Job, capture: Capture, labels: int, started: float) -> StagePlan[TrainingSettings]:
    """The plan of the job's training: an earlier attempt's if there is one, else a new one, which is then stored.

    Args:
        job: what is trained.
        capture: of the job.
        labels: entries of its dictionary.
        started: `time.monotonic()` at the start of the training stage.
    """
    budget = job.options.time_budget_s
    if budget is not None and not (job.folder / _PLAN).exists():
        spent = stage_seconds(job, "perception") + time.monotonic() - started
        plan = plan_training(capture, job.settings, labels, budget, spent_s=spent, speed_of=lambda _: job_speed(job))
        _store(job, plan)
    return stored_plan(job)


def stored_plan(job: Job) -> StagePlan[TrainingSettings]:
    """The plan that the training stage follows or followed; without a time budget that is the job's settings."""
    if not (job.folder / _PLAN).exists():
        return StagePlan(job.settings.training)
    with intact(job.folder / _PLAN):
        stored = json.loads((job.folder / _PLAN).read_text())
        return StagePlan(TrainingSettings.model_validate(stored["settings"]), tuple(stored["tradeoffs"]))


def _store(job: Job, plan: StagePlan[TrainingSettings]) -> None:
    """Write the plan unless another attempt was faster; whole or not at all."""
    part = job.folder / f"{_PLAN}.{job.attempt}.part"
    part.write_text(json.dumps({"settings": plan.settings.model_dump(mode="json"), "tradeoffs": plan.tradeoffs}))
    try:
        os.link(part, job.folder / _PLAN)
    except FileExistsError:
        pass
    finally:
        part.unlink()
