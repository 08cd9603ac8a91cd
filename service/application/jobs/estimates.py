"""Estimated job time on this machine, before anything is uploaded."""

from __future__ import annotations

import math
import threading
import time
from typing import TYPE_CHECKING

from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.planning.presets import chosen_settings
from fastsplat.service.settings import Settings
from fastsplat.service.store.rows.records import PREDICTED_S
from fastsplat_contract.errors import LimitExceededError
from fastsplat_contract.jobs.operations import JobEstimate, SceneOptions
from fastsplat_contract.messages.requests import EstimateJobRequest

if TYPE_CHECKING:
    from fastsplat.service.planning.cost_model import Speed
    from fastsplat.service.planning.job_time import PhotoSet

_AGAIN_S = 600.0
"""Interval in seconds between measurements of the machine."""
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
