"""Prediction of job time: reference seconds per stage, corrected by completed stages."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.upload_manifest import UploadManifest
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.planning.cost_model import (
    PerceptionCost,
    SceneSize,
    Speed,
    export_seconds,
    run_seconds,
    run_seconds_left,
    scene_size,
)
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.training_settings import TrainingSettings

STAGES = ("capture", "perception", "training", "export")
PACED = ("capture", "perception")
"""Stages whose time reveals the machine's speed; training may end by the clock, or early."""

_USUAL_LABELS = 30
"""Dictionary size assumed before detection."""
_POINTS_A_PHOTO = 130
_PROMISING_PAIRS = 0.65
"""Share of requested image pairs that remain, as two images often choose each other."""
_SEARCH_S, _SEGMENT_S, _MODELS_S = 0.11, 1.1, 1.2
_DRAFT_S = 3.5
"""Seconds of the draft on the capture's points, made while the first views are labelled."""

_TRUST = 2.0
"""Variance of the log error of a measured speed, relative to that of a stage."""
_LEAST_FRACTION, _LEAST_SECONDS = 0.05, 1.0
"""Before this fraction and time, a stage's rate is not used."""
_LEAST_SHARE = 0.5
"""Least share of an overrunning stage's remaining time at its rate."""


@dataclass(frozen=True)
class PhotoSet:
    """Number of photos and their usual size in pixels."""

    count: int
    width: int
    height: int


@dataclass(frozen=True)
class JobTime:
    """Known timing of a job when one of its stages begins.

    Attributes:
        seconds: per stage at a speed; unpredictable stages (capture of a video) are missing.
        ran: completed stages: expected seconds, actual seconds, observed share 0..1.
        run: settings and scene size of the training; None: not known yet.
        budget_s: seconds left for all stages after the capture; None: no bound.
    """

    seconds: Callable[[Speed], Mapping[str, float]]
    speed: Speed
    ran: tuple[tuple[float, float, float], ...] = ()
    run: tuple[TrainingSettings, SceneSize] | None = None
    budget_s: float | None = None

    @property
    def speed_now(self) -> Speed:
        """The measured speed, corrected by the completed stages."""
        return self.speed.slowed(times_as_long(self.ran))


def photo_set(manifest: UploadManifest) -> PhotoSet | None:
    """Photos of an upload; None if they came with poses or label maps."""
    if manifest.source != "images" or manifest.label_maps:
        return None
    middle = sorted(photo.upright_size for photo in manifest.photos)[len(manifest.photos) // 2]
    return PhotoSet(len(manifest.photos), *middle)


def job_seconds(photos: PhotoSet, settings: Settings, speed: Speed) -> dict[str, float]:
    """Seconds of each stage, in order, for photos without poses; `settings` have the preset applied."""
    capture, count = settings.capture, photos.count
    width, height = _reduced(photos, capture.sfm_max_side)
    megapixels, sent = width * height / 1e6, photos.width * photos.height / 1e6
    pairs = count * (count - 1) / 2
    if count > capture.exhaustive_images:
        pairs = min(pairs, _PROMISING_PAIRS * capture.pairs_per_image * count)
    parallel = count * (0.06 + 0.15 * megapixels) + pairs * (0.024 + 0.02 * min(megapixels, 1.0))
    serial = 0.8 + count * (0.16 + 0.16 * min(sent, 2.0) + 0.05 * sent)
    serial += 0.004 * count * min(count, capture.global_mapping_images)
    width, height = _reduced(photos, capture.max_side)
    size = SceneSize(count, width, height, _POINTS_A_PHOTO * count, labels=0)
    placed = _placed_seconds(size, settings, settings.training, speed, _USUAL_LABELS)
    return {"capture": parallel / speed.steps + serial / speed.serial, **placed}


def placed_seconds(
    capture: Capture, settings: Settings, training: TrainingSettings, speed: Speed, labels: int = 0
) -> dict[str, float]:
    """Seconds of the stages after the capture; for an imported splat only the export."""
    given = capture.given_labels is not None
    labels = labels or _USUAL_LABELS
    stages = _placed_seconds(scene_size(capture, labels), settings, training, speed, labels, given)
    return {"export": stages["export"]} if capture.splat is not None else stages


def _placed_seconds(
    size: SceneSize, settings: Settings, training: TrainingSettings, speed: Speed, labels: int, has_maps: bool = False
) -> dict[str, float]:
    """With `has_maps` (label maps came with the capture), masks are proposed during export."""
    perception, views = settings.perception, size.views
    masks = settings.discovery.proposes(given_labels=has_maps)
    seen = min(perception.proposal_views or views, views) if masks or not has_maps else 0
    cost = PerceptionCost(_MODELS_S + _DRAFT_S, _SEARCH_S, _SEGMENT_S, perception.proposal_views if masks else 0)
    looked_at = 0 if has_maps else min(perception.max_views or views, views)
    return {
        "perception": cost.seconds(looked_at) / speed.networks,
        "training": run_seconds(training, size, speed),
        "export": export_seconds(settings.training, size, labels, seen, seen if has_maps else 0, speed),
    }


def _reduced(photos: PhotoSet, side: int) -> tuple[int, int]:
    factor = min(1.0, side / max(photos.width, photos.height, 1))
    return math.ceil(photos.width * factor), math.ceil(photos.height * factor)


def times_as_long(ran: Iterable[tuple[float, float, float]]) -> float:
    """Slowdown of the next stages by those that `ran`, most likely under log-normal errors."""
    seen = [(math.log(actual / expected), share) for expected, actual, share in ran if min(expected, actual) > 0]
    return math.exp(sum(ratio * share for ratio, share in seen) / (1 / _TRUST + sum(share for _, share in seen)))


class _TimeLeft:
    """Estimates a stage's end from training steps, or from expected time and rate."""

    def __init__(self, stage: str, known: JobTime) -> None:
        self._stage, self._known = stage, known
        self._later = STAGES[STAGES.index(stage) + 1 :]
        self._at_first = known.seconds(known.speed).get(stage)
        self._expected = self._ends_s = known.seconds(known.speed_now).get(stage)
        self._fraction = 0.0

    def seconds(self, event: ProgressEvent, elapsed_s: float) -> float | None:
        """Seconds until the job is done, `elapsed_s` into the stage; None: unknown."""
        self._hear(event, elapsed_s)
        known, ran, left = self._known, self._known.ran, None
        if self._stage in PACED and self._at_first and self._ends_s:
            ran = (*ran, (self._at_first, max(self._ends_s, elapsed_s), self._fraction))
        stages = known.seconds(known.speed.slowed(times_as_long(ran)))
        if self._ends_s is not None and all(stage in stages for stage in self._later):
            later = sum(stages[stage] for stage in self._later)
            if known.budget_s is not None and self._stage == "capture":
                later = min(later, known.budget_s)
            unseen = 1 - min(event.fraction, 1.0)
            left = later + max(self._ends_s - elapsed_s, _LEAST_SHARE * unseen * max(self._ends_s, elapsed_s))
        if known.budget_s is None or self._stage != "perception" or elapsed_s >= known.budget_s:
            return left
        return min(known.budget_s - elapsed_s, math.inf if left is None else left)

    def _hear(self, event: ProgressEvent, elapsed_s: float) -> None:
        if self._known.run is not None and "iteration" in event.metrics:
            iteration, ran_s = int(event.metrics["iteration"]), event.metrics["elapsed_s"]
            self._ends_s = elapsed_s + run_seconds_left(*self._known.run, self._known.speed_now, iteration, ran_s)
        elif self._fraction < event.fraction and event.fraction >= _LEAST_FRACTION and elapsed_s >= _LEAST_SECONDS:
            self._fraction = min(event.fraction, 1.0)
            if self._stage != "training" or self._known.run is None:
                rate_s = elapsed_s / self._fraction
                self._ends_s = (self._expected or rate_s) ** (1 - self._fraction) * rate_s**self._fraction


def with_time_left(
    progress: Progress, stage: str, known: JobTime, clock: Callable[[], float] = time.monotonic
) -> Progress:
    """Adds the metric job_seconds_left (-1: unknown) to the events of a beginning stage."""
    started, time_left = clock(), _TimeLeft(stage, known)

    def tell(event: ProgressEvent) -> None:
        left = time_left.seconds(event, clock() - started)
        progress(
            replace(event, metrics={**event.metrics, "job_seconds_left": -1.0 if left is None else round(left, 1)})
        )

    return tell
