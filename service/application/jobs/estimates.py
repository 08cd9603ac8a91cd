"""Estimated durations of jobs on this machine, and expected starts of waiting ones."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping, Sequence
from heapq import heapify, heapreplace
from typing import TYPE_CHECKING

from fastsplat.service.application.jobs.stored import Ahead
from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.planning.presets import chosen_settings
from fastsplat.service.settings import Settings
from fastsplat.service.store.rows.records import PREDICTED_S, SECONDS_LEFT, OperationRecord, QueuedJob
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import LimitExceededError
from fastsplat_contract.jobs.operations import JobEstimate, SceneOptions
from fastsplat_contract.messages.requests import EstimateJobRequest

if TYPE_CHECKING:
    from fastsplat.service.planning.cost_model import Speed
    from fastsplat.service.planning.job_time import PhotoSet

_AGAIN_S = 600.0
"""Interval in seconds between measurements of the machine."""
_FRESH_S = 1.0
"""Age up to which a forecast serves again: each watcher of a waiting job asks several times a second."""
_USUAL_WIDTH, _USUAL_HEIGHT = 4_000, 3_000


class JobEstimates:
    """Job estimates; the first measures this machine for a second or two."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._speed: Speed | None = None
        self._measured_at = 0.0

    def estimate(self, request: EstimateJobRequest) -> JobEstimate:
        """Estimates the time from photos to a scene; raises `LimitExceededError` for too many photos."""
        most = self._settings.capture.max_images
        if request.photos > most:
            raise LimitExceededError(f"{request.photos} photos", field="photos", limit=f"{most} photos")
        from fastsplat.service.planning.job_time import PhotoSet  # loads torch

        photos = PhotoSet(request.photos, request.width or _USUAL_WIDTH, request.height or _USUAL_HEIGHT)
        stages = self._stages(photos, SceneOptions(preset=request.preset), self._measured())
        return JobEstimate(round(sum(stages.values()), 1), stages)

    def predicted(self, upload: ValidatedUpload, options: SceneOptions) -> dict[str, float]:
        """Predicted seconds of a photo job, once the machine is measured, as job options."""
        if self._speed is None:  # measuring takes torch and a second: not while somebody waits for the answer
            return {}
        from fastsplat.service.planning.job_time import photo_set

        photos = photo_set(read_manifest(upload.folder)[0])
        if photos is None:
            return {}
        stages = self._stages(photos, options, self._speed)
        later = sum(seconds for stage, seconds in stages.items() if stage != "capture")
        return {PREDICTED_S: round(stages["capture"] + min(later, options.time_budget_s or math.inf), 1)}

    def _stages(self, photos: PhotoSet, options: SceneOptions, speed: Speed) -> dict[str, float]:
        from fastsplat.service.planning.job_time import job_seconds

        seconds = job_seconds(photos, chosen_settings(self._settings, options), speed)
        return {name: round(value, 1) for name, value in seconds.items()}

    def _measured(self) -> Speed:
        from fastsplat.service.planning.machine import machine_speed

        with self._lock:
            if self._speed is None or time.monotonic() - self._measured_at > _AGAIN_S:
                self._speed, self._measured_at = machine_speed(self._settings.training.backend), time.monotonic()
            return self._speed


class QueueTimes:
    """Forecasts the queue of all projects, shared by all callers. Thread-safe."""

    def __init__(self, store: Store, timeout_s: float) -> None:
        self._store, self._timeout_s = store, timeout_s
        self._lock = threading.Lock()
        self._ahead: Mapping[str, Ahead] = {}
        self._read_at = -math.inf

    def ahead(self, records: Sequence[OperationRecord]) -> Mapping[str, Ahead]:
        """Jobs ahead of waiting ones among these, and their expected starts; empty if none waits."""
        waiting = {record.id for record in records if record.state == "QUEUED"}
        if not waiting:
            return {}
        with self._lock:
            if time.monotonic() - self._read_at > _FRESH_S or not waiting <= self._ahead.keys():
                self._ahead, self._read_at = self._forecast(), time.monotonic()
            return self._ahead

    def _forecast(self) -> Mapping[str, Ahead]:
        heard_since, jobs = time.time() - self._timeout_s, self._store.jobs
        under_way = jobs.running(owned=True)
        ends = [_seconds_of(job, heard_since) for job in under_way]
        ends += [0.0] * (self._store.workers.alive(self._timeout_s) - len(ends))
        heapify(ends := ends or [math.inf])
        ahead, number = {}, sum(not job.cancel_requested for job in under_way)
        waiting: Sequence[OperationRecord | QueuedJob] = [*jobs.running(owned=False), *jobs.queued_in_turn()]
        for job in waiting:
            ahead[job.id] = number, ends[0]
            number += not job.cancel_requested
            heapreplace(ends, ends[0] + _seconds_of(job, heard_since))  # the first free worker takes it
        return ahead


def _seconds_of(job: OperationRecord | QueuedJob, heard_since: float) -> float:
    """Remaining seconds of a job, as predicted or last reported; infinite: unknown."""
    if job.cancel_requested:
        return 0.0
    if isinstance(job, QueuedJob):
        return float(job.options.get(PREDICTED_S, math.inf))
    left = job.stages[-1]["metrics"].get(SECONDS_LEFT, -1) if job.stages and job.updated_at >= heard_since else -1
    return float(left) if left >= 0 else math.inf
