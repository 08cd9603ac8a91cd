"""Detections of every view of a capture: which detector looks for what."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from fastsplat.service.common.dictionary import dictionary_of, label_key
from fastsplat.service.perception.class_names import TAGS
from fastsplat.service.perception.detection_voting import merge_spellings, resolve_detections
from fastsplat.service.perception.detectors.open_detectors import (
    closed_set_labels,
    open_closed_set_detector,
    open_open_set_detector,
)
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.tagging import propose_texts
from fastsplat.service.perception.types import ClosedSetDetector, Detections, Image, joined
from fastsplat_contract.errors import InvalidInputError

_TAGGER_VIEWS = 16
"""Views that are tagged, evenly spread; 0: all."""

_CROP = 0.6
_CUT_PX = 4

LoadImage = Callable[[int], Image]
"""Loads the image of a position among the views that perception looks at."""

OnView = Callable[[int, str], None]
"""Called with the number of views done in this pass and a line for people; may raise `CancelledError`."""


def detect_views(
    load: LoadImage, count: int, labels: Sequence[str], settings: PerceptionSettings, models: Path, on_view: OnView
) -> tuple[list[Detections], tuple[str, ...]]:
    """Raw detections of every view, scoring the settings' floor at least, with one name for each class; and the names
    that were looked for.

    With an open-set detector: prompted by the user's labels, else by what the tagger proposes, else by what
    `settings.prompt_source` says. Without: what the closed-set detector detects, of the user's labels only if there are
    any.

    Args:
        load: loads the image of a view.
        count: views, numbered from 0.
        labels: names to look for; empty: whatever is there.
        settings: models and thresholds.
        models: the model directory.
        on_view: called after every view.

    Raises:
        InvalidInputError: the closed-set detector cannot know some of the labels; names them.
        ModelUnavailableError: see the detectors.
    """
    names = [entry.label for entry in dictionary_of(labels).entries]
    if not settings.open_set_detector:
        check_labels_known(names, settings)
        closed = open_closed_set_detector(settings, models)
        return _closed_set_pass(closed, load, count, names, settings, on_view), tuple(names) or closed.labels
    prompts = names or _prompts(load, count, settings, models, on_view)
    detector = open_open_set_detector(settings, models)
    detections = []
    for view in range(count):
        detections.append(detector.detect(load(view), prompts, settings.open_score_floor))
        on_view(view + 1, f"looking for {len(prompts)} classes of objects, view {view + 1}/{count}")
    return merge_spellings(detections, prompts), tuple(prompts)


def _prompts(load: LoadImage, count: int, settings: PerceptionSettings, models: Path, on_view: OnView) -> list[str]:
    if settings.tagger:
        texts = propose_texts(load, spread(count, _TAGGER_VIEWS), settings, models, on_view)
        if texts:
            return texts
    if settings.prompt_source == "closed_set":
        closed = open_closed_set_detector(settings, models)
        detections = _closed_set_pass(closed, load, count, [], settings, on_view)
        resolved, _ = resolve_detections(detections, settings, named=False)
        classes = dict.fromkeys(label for view in resolved for label in view.labels)
        if classes:
            return list(classes)
    return list(settings.tags or TAGS)


def _closed_set_pass(
    detector: ClosedSetDetector,
    load: LoadImage,
    count: int,
    names: Sequence[str],
    settings: PerceptionSettings,
    on_view: OnView,
) -> list[Detections]:
    keys = {label_key(name) for name in names}
    detections = []
    for view in range(count):
        image = load(view)
        everything = detect_closed_set(detector, image, settings)
        rows = [row for row, label in enumerate(everything.labels) if not keys or label_key(label) in keys]
        detections.append(everything.take(rows))
        on_view(view + 1, f"looking for objects, view {view + 1}/{count}")
    return merge_spellings(detections, names)


def detect_closed_set(detector: ClosedSetDetector, image: Image, settings: PerceptionSettings) -> Detections:
    """All objects that the detector detects in uint8 [H, W, 3] and that score `score_floor`; with `closer_look`, in the
    image's four corners as well."""
    if not settings.closer_look:
        return detector.detect(image, settings.score_floor)
    return _detect_in_crops(detector, image, settings.score_floor)


def _detect_in_crops(detector: ClosedSetDetector, image: Image, min_score: float) -> Detections:
    """What the detector detects in the whole image and in its four corners, each _CROP of the sides; a box that ends
    where its crop ends, inside the image, is a part of an object and does not count."""
    height, width = image.shape[:2]
    crop_height, crop_width = round(height * _CROP), round(width * _CROP)
    parts = [detector.detect(image, min_score)]
    for top in (0, height - crop_height):
        for left in (0, width - crop_width):
            crop = np.ascontiguousarray(image[top : top + crop_height, left : left + crop_width])
            detections = detector.detect(crop, min_score)
            boxes = detections.boxes + np.array([left, top, left, top], np.float32)
            inner = np.array([left, top, left + crop_width, top + crop_height], np.float32)
            outer = np.array([0, 0, width, height], np.float32)
            cut = (np.abs(boxes - inner) < _CUT_PX) & (inner != outer)
            whole = np.flatnonzero(~cut.any(1))
            parts.append(Detections(boxes, detections.scores, detections.labels).take(whole))
    return joined(parts)


def spread(total: int, limit: int) -> list[int]:
    """Positions of at most `limit` of `total` views, evenly spread, first and last included; 0: all."""
    if not limit or limit >= total:
        return list(range(total))
    return sorted({round(position) for position in np.linspace(0, total - 1, limit)})


def check_labels_known(names: Sequence[str], settings: PerceptionSettings) -> None:
    """Raise unless the configured detectors can look for all of these names; no model is opened.

    Raises:
        InvalidInputError: there is no open-set detector, and the closed-set detector cannot know some; names them.
        ModelUnavailableError: no such closed-set detector.
    """
    if settings.open_set_detector or not names:
        return
    known = {label_key(label) for label in closed_set_labels(settings)}
    unknown = [name for name in names if label_key(name) not in known]
    if unknown:
        raise InvalidInputError(
            f"the closed-set detector {settings.closed_set_detector} cannot know: {', '.join(unknown)}",
            field="labels",
            hint="Configure an open-set detector (FASTSPLAT_PERCEPTION__OPEN_SET_DETECTOR), or leave these labels out.",
        )
