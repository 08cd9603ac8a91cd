"""Forecast of a job's length at the start of each stage."""

from __future__ import annotations

from fastsplat.service.capture.types import Capture
from fastsplat.service.planning.cost_model import finish_seconds, run_seconds, scene_size
from fastsplat.service.planning.time_budget import whole_export_seconds
from fastsplat.service.planning.time_left import Forecast
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.workers.budget import job_speed
from fastsplat.workers.protocol import Job

_USUAL_LABELS = 30
"""In a dictionary that a detector has yet to fill."""


def perception_forecast(job: Job, capture: Capture) -> Forecast:
    """Of a job whose poses are known: its rate will tell how long perception takes; the rest the cost model says."""
    if capture.splat is not None:  # its labels are lifted, which nothing predicts
        return Forecast(None, bound_s=job.options.time_budget_s)
    settings, labels, speed = job.settings, len(job.options.labels) or _USUAL_LABELS, job_speed(job)
    later = run_seconds(settings.training, scene_size(capture, labels), speed)
    later += whole_export_seconds(capture, settings, labels, speed)
    return Forecast(later, bound_s=job.options.time_budget_s)


def training_forecast(job: Job, capture: Capture, labels: int, planned: TrainingSettings) -> Forecast:
    """Of a job whose labels are known; `planned` is what it trains with."""
    speed = job_speed(job)
    later = whole_export_seconds(capture, job.settings, labels, speed)
    if capture.splat is not None:
        return Forecast(later)
    size = scene_size(capture, labels)
    return Forecast(later, run_seconds(planned, size, speed), finish_seconds(planned, size, speed))


def export_forecast(job: Job, capture: Capture, labels: int) -> Forecast:
    """Of a job that is trained."""
    return Forecast(0.0, whole_export_seconds(capture, job.settings, labels, job_speed(job)))
