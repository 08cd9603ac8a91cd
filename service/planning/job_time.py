"""How long a job takes from photos to a scene, before it begins and while it runs: the reference machine's seconds of
each stage, divided by the machine's `Speed`, which every stage that ran here corrects."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

from fastsplat.service.capture.captures import Capture
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
from fastsplat.service.splatting.settings import TrainingSettings

STAGES = ("capture", "perception", "training", "export")
PACED = ("capture", "perception")
"""Stages whose time tells how fast the machine is; the clock ends a training."""

_USUAL_LABELS = 30
"""In a dictionary that a detector has yet to fill."""
_POINTS_A_PHOTO = 130
_PROMISING_PAIRS = 0.65
"""Of the pairs that are asked for an image, as two images often choose each other."""
_SEARCH_S, _SEGMENT_S, _MODELS_S = 0.11, 1.5, 1.2
_DRAFT_S = 3.5
"""Of the scene on the capture's points, which is made while the first views are known."""

_TRUST = 2.0
"""Variance of the logarithm of a measured speed's error, in times that of a stage's."""
_LEAST_FRACTION, _LEAST_SECONDS = 0.05, 1.0
"""Before that, the rate of a stage says nothing."""
_LEAST_SHARE = 0.5
"""A stage that takes longer than expected is said to need this part of what the rest of it takes at its rate."""


@dataclass(frozen=True)
class PhotoSet:
    """Photos of which no more is known than their number and the pixels of most."""

    count: int
    width: int
    height: int


@dataclass(frozen=True)
class JobTime:
    """What is known of a job's time when one of its stages begins.

    Attributes:
        seconds: of each stage at a speed, by name; one that cannot be predicted, as the capture of a video, is missing.
        speed: measured when the job began.
        ran: expected and actual seconds of the stages before, and the share of each that was seen, 0..1.
        run: what trains, and the size of its scene; None: not known yet.
        budget_s: what is left of the seconds for all stages after the capture; None: no bound.
    """

    seconds: Callable[[Speed], Mapping[str, float]]
    speed: Speed
    ran: tuple[tuple[float, float, float], ...] = ()
    run: tuple[TrainingSettings, SceneSize] | None = None
    budget_s: float | None = None

    @property
    def speed_now(self) -> Speed:
        """The speed that was measured, corrected by the stages before."""
        return self.speed.slowed(times_as_long(self.ran))


def job_seconds(photos: PhotoSet, settings: Settings, speed: Speed) -> dict[str, float]:
    """Seconds of each stage of photos without poses, by its name, in order; `settings` have the preset applied."""
    capture, count = settings.capture, photos.count
    width, height = _reduced(photos, capture.sfm_max_side)
    megapixels, sent = width * height / 1e6, photos.width * photos.height / 1e6
    pairs = count * (count - 1) / 2
    if count > capture.exhaustive_images:
        pairs = min(pairs, _PROMISING_PAIRS * capture.pairs_per_image * count)
    parallel = count * (0.12 + 0.36 * megapixels) + pairs * (0.024 + 0.02 * min(megapixels, 1.0))
    serial = 0.8 + count * (0.16 + 0.16 * min(sent, 2.0) + 0.05 * sent)
    serial += 0.004 * count * min(count, capture.global_mapping_images)
    width, height = _reduced(photos, capture.max_side)
    size = SceneSize(count, width, height, _POINTS_A_PHOTO * count, labels=0)
    placed = _placed_seconds(size, settings, settings.training, speed, _USUAL_LABELS)
    return {"capture": parallel / speed.steps + serial / speed.serial, **placed}


def placed_seconds(
    capture: Capture, settings: Settings, training: TrainingSettings, speed: Speed, labels: int = 0
) -> dict[str, float]:
    """As `job_seconds`, of the stages after the capture, with so many labels in the dictionary if that is known; of a
    splat that is imported, of the export alone."""
    given = capture.given_labels is not None
    labels = labels or _USUAL_LABELS
    stages = _placed_seconds(scene_size(capture, labels), settings, training, speed, labels, given)
    return {"export": stages["export"]} if capture.splat is not None else stages


def _placed_seconds(
    size: SceneSize, settings: Settings, training: TrainingSettings, speed: Speed, labels: int, has_maps: bool = False
) -> dict[str, float]:
    """Where label maps came with the capture (`has_maps`), masks are looked for in the export."""
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
    """How many times as long as expected the next stages take, by those that `ran`, see `JobTime`: the likeliest value
    where the errors of a speed and of a stage are log-normal."""
    seen = [(math.log(actual / expected), share) for expected, actual, share in ran if min(expected, actual) > 0]
    return math.exp(sum(ratio * share for ratio, share in seen) / (1 / _TRUST + sum(share for _, share in seen)))


class _TimeLeft:
    """When a stage ends: by the steps of a training, or between what was expected and its rate, by how far it is."""

    def __init__(self, stage: str, known: JobTime) -> None:
        self._stage, self._known = stage, known
        self._later = STAGES[STAGES.index(stage) + 1 :]
        self._at_first = known.seconds(known.speed).get(stage)
        self._expected = self._ends_s = known.seconds(known.speed_now).get(stage)
        self._fraction = 0.0

    def seconds(self, event: ProgressEvent, elapsed_s: float) -> float | None:
        """Seconds until the whole job is done, `elapsed_s` seconds after the stage began; None: unknown."""
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
    """A `Progress` of a stage that begins now, whose events say how long the whole job still takes, as the metric
    job_seconds_left; -1 where that cannot be predicted."""
    started, time_left = clock(), _TimeLeft(stage, known)

    def tell(event: ProgressEvent) -> None:
        left = time_left.seconds(event, clock() - started)
        progress(
            replace(event, metrics={**event.metrics, "job_seconds_left": -1.0 if left is None else round(left, 1)})
        )

    return tell
