"""Keeps a job's training plan and its machine's speed on disk; the first attempt finds them."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from dataclasses import asdict

from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.planning.cost_model import Speed, scene_size
from fastsplat.service.planning.job_time import PACED, JobTime, PhotoSet, job_seconds, photo_set, placed_seconds
from fastsplat.service.planning.machine import machine_speed
from fastsplat.service.planning.time_budget import StagePlan, plan_training
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.workers.job.protocol import Job
from fastsplat.workers.job.results import intact, stage_seconds
from fastsplat_contract.errors import InvalidInputError, NotFoundError

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


def job_time(
    job: Job, capture: Capture | None = None, labels: int = 0, planned: TrainingSettings | None = None
) -> JobTime:
    """Predicts a job's time by its finished stages; without a `capture`, of photos without poses alone."""
    settings, training = job.settings, planned or job.settings.training
    photos = _photos(job)

    def seconds(speed: Speed) -> Mapping[str, float]:
        before = {} if photos is None else job_seconds(photos, settings, speed)
        return before if capture is None else {**before, **placed_seconds(capture, settings, training, speed, labels)}

    speed = job_speed(job)
    expected = seconds(speed)
    done = [stage for stage in PACED if stage in expected and job.result(stage).is_dir()]
    ran = tuple((expected[stage], stage_seconds(job, stage), 1.0) for stage in done)
    run = None if capture is None or capture.splat is not None else (training, scene_size(capture, labels))
    return JobTime(seconds, speed, ran, run, job.options.time_budget_s)


def _photos(job: Job) -> PhotoSet | None:
    try:
        return photo_set(read_manifest(job.upload)[0])
    except (OSError, InvalidInputError, NotFoundError):  # files that show people go before the training
        return None


def make_plan(job: Job, capture: Capture, labels: int, started: float) -> StagePlan[TrainingSettings]:
    """Reads the plan of an earlier attempt, or stores a new one; `started` is of `time.monotonic()`."""
    budget = job.options.time_budget_s
    if budget is not None and not (job.folder / _PLAN).exists():
        spent, speed = stage_seconds(job, "perception") + time.monotonic() - started, job_time(job, capture).speed_now
        plan = plan_training(capture, job.settings, labels, budget, spent_s=spent, speed_of=lambda _: speed)
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
