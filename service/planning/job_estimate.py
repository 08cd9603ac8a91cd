"""How long photos without poses take to become a scene, said before any is read, by the reference machine's seconds and
`Speed`; stages may be off by half, the whole job by less."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fastsplat.service.planning.cost_model import PerceptionCost, SceneSize, Speed, export_seconds, run_seconds
from fastsplat.service.settings import Settings

USUAL_LABELS = 30
"""In a dictionary that a detector has yet to fill."""

_POINTS_A_PHOTO = 130
_PROMISING_PAIRS = 0.65
"""Of the pairs that are asked for an image, as two images often choose each other."""
_SEARCH_S, _SEGMENT_S, _MODELS_S = 0.11, 1.5, 1.2
_DRAFT_S = 3.5
"""Of the scene on the capture's points, which is made while the first views are known."""


@dataclass(frozen=True)
class PhotoSet:
    """Photos of which no more is known.

    Attributes:
        count: of the photos.
        width, height: of most, pixels.
    """

    count: int
    width: int
    height: int


def job_seconds(photos: PhotoSet, settings: Settings, speed: Speed) -> dict[str, float]:
    """Seconds of each stage of a job on a machine, by its name, in order.

    Args:
        photos: without poses.
        settings: of all rooms, with the preset applied.
    """
    return {"capture": capture_seconds(photos, settings, speed), **later_seconds(photos, settings, speed)}


def later_seconds(photos: PhotoSet, settings: Settings, speed: Speed) -> dict[str, float]:
    """As `job_seconds`, of the stages after the capture."""
    perception, count = settings.perception, photos.count
    masks = settings.discovery.proposes(given_labels=False)
    cost = PerceptionCost(_MODELS_S + _DRAFT_S, _SEARCH_S, _SEGMENT_S, perception.proposal_views if masks else 0)
    width, height = _reduced(photos, settings.capture.max_side)
    size = SceneSize(count, width, height, _POINTS_A_PHOTO * count, labels=0)
    seen = min(perception.proposal_views or count, count)
    return {
        "perception": cost.seconds(min(perception.max_views or count, count)) / speed.networks,
        "training": run_seconds(settings.training, size, speed),
        "export": export_seconds(settings.training, size, USUAL_LABELS, seen, 0, speed),
    }


def capture_seconds(photos: PhotoSet, settings: Settings, speed: Speed) -> float:
    """Seconds until the photos have places, fitted to captures of 10 and 26 photos; a kitchen took nearly twice as
    much."""
    capture, count = settings.capture, photos.count
    width, height = _reduced(photos, capture.sfm_max_side)
    megapixels, sent = width * height / 1e6, photos.width * photos.height / 1e6
    pairs = count * (count - 1) / 2
    if count > capture.exhaustive_images:
        pairs = min(pairs, _PROMISING_PAIRS * capture.pairs_per_image * count)
    parallel = count * (0.075 + 0.225 * megapixels) + pairs * (0.015 + 0.0125 * min(megapixels, 1.0))
    serial = 0.5 + count * (0.1 + 0.1 * min(sent, 2.0) + 0.03 * sent)
    serial += 0.0025 * count * min(count, capture.global_mapping_images)
    return parallel / speed.steps + serial / speed.serial


def _reduced(photos: PhotoSet, side: int) -> tuple[int, int]:
    factor = min(1.0, side / max(photos.width, photos.height, 1))
    return math.ceil(photos.width * factor), math.ceil(photos.height * factor)
