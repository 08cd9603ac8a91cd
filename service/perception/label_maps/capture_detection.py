"""Detections in all views of a capture, by the configured detectors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic

import numpy as np

from fastsplat.service.common.dictionary import dictionary_of, label_key
from fastsplat.service.perception.class_names import TAGS
from fastsplat.service.perception.detectors.open_detectors import (
    closed_set_labels,
    known_texts,
    of_open_set,
    open_closed_set_detector,
    open_open_set_detector,
)
from fastsplat.service.perception.label_maps.detection_voting import merge_spellings, resolve_detections
from fastsplat.service.perception.label_maps.side_by_side import in_order, side_by_side
from fastsplat.service.perception.models.model_manifest import is_prompted_by_classes
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import ClosedSetDetector, Detections, Image, joined
from fastsplat.service.perception.tagging import propose_texts
from fastsplat_contract.errors import InvalidInputError

_TAGGER_VIEWS = 16  # views that are tagged, evenly spread; 0: all

_OPEN_SET_S = 240.0
"""Seconds that an open-set detector may look for, at least at `min_views`; OWLv2 takes several a view."""

_CROP = 0.6
_CUT_PX = 4

LoadImage = Callable[[int], Image]
"""Loads an image by its position among the views for perception."""

OnView = Callable[[int, str], None]
"""Called with the number of views done and a message; may raise `CancelledError`."""


class CaptureDetector:
    """Detects the objects of a capture's views, once per view, in any order.

    An open-set detector is prompted by the labels, else by the tagger, by classes or by tags; without one the
    closed-set detector is used. `searched` has the names that are looked for.

    Args:
        count: views, numbered from 0.
        labels: names to look for; empty: anything.

    Raises:
        InvalidInputError: names labels that the closed-set detector does not know.
        ModelUnavailableError: see the detectors.
    """

    def __init__(
        self,
        load: LoadImage,
        count: int,
        labels: Sequence[str],
        settings: PerceptionSettings,
        models: Path,
        on_view: OnView,
    ) -> None:
        self._load, self._count, self._on_view = load, count, on_view
        self._found: dict[int, Detections] = {}
        self._settings = settings
        self._at_once, of_each = side_by_side(settings)
        names = [entry.label for entry in dictionary_of(labels).entries]
        if not settings.open_set_detector:
            check_labels_known(names, settings)
            closed = open_closed_set_detector(of_each, models)
            self._spellings: Sequence[str] = names
            self.searched = tuple(names) or closed.labels
            self._message = "looking for objects"
            self._detect: Callable[[Image], Detections] = lambda image: _detect_named(closed, image, names, settings)
            return
        prompts = names or known_texts(_prompts(load, count, settings, models, on_view), settings, models)
        detector = open_open_set_detector(of_each, models)
        self._spellings = prompts
        self.searched = tuple(prompts)
        self._message = f"looking for {len(prompts)} classes of objects"
        floor = of_open_set(settings).score_floor
        self._detect = lambda image: detector.detect(image, prompts, floor)

    @property
    def done(self) -> int:
        """The number of views that were looked at."""
        return len(self._found)

    def limited(self) -> list[int]:
        """Looks at the first view; returns positions of views that an open-set detector has time for, spread.

        Their number replaces that of the views; raises as `detections`.
        """
        if self._settings.open_set_detector and self._count:
            begin = monotonic()
            self.detections([0])
            seconds = (monotonic() - begin) / self._at_once
            limit = max(self._settings.min_views, int(_OPEN_SET_S / max(seconds, 1e-6)))
            chosen, self._count = spread(self._count, limit), min(self._count, limit)
            return chosen
        return list(range(self._count))

    def detections(self, views: Sequence[int]) -> list[Detections]:
        """Returns raw detections above the score floor, with one name per class.

        Views that were not looked at yet are. Raises `CancelledError` if `on_view` does.
        """
        new = [view for view in views if view not in self._found]
        found = in_order(lambda view: self._detect(self._load(view)), new, self._at_once)
        for view, detections in zip(new, found, strict=True):
            self._found[view] = detections
            self._on_view(len(self._found), f"{self._message}, view {len(self._found)}/{self._count}")
        return merge_spellings([self._found[view] for view in views], self._spellings)


def _prompts(load: LoadImage, count: int, settings: PerceptionSettings, models: Path, on_view: OnView) -> list[str]:
    if settings.tagger:
        texts = propose_texts(load, spread(count, _TAGGER_VIEWS), settings, models, on_view)
        if texts:
            return texts
    if is_prompted_by_classes(settings):
        closed_set = settings.model_copy(update={"open_set_detector": ""})
        detector = CaptureDetector(load, count, (), closed_set, models, on_view)
        resolved, _ = resolve_detections(detector.detections(range(count)), settings, named=False)
        classes = dict.fromkeys(label for view in resolved for label in view.labels)
        if classes:
            return list(classes)
    return list(settings.tags or TAGS)


def _detect_named(
    detector: ClosedSetDetector, image: Image, names: Sequence[str], settings: PerceptionSettings
) -> Detections:
    """Detects objects of these names; without names, everything."""
    keys = {label_key(name) for name in names}
    everything = detect_closed_set(detector, image, settings)
    return everything.take([row for row, label in enumerate(everything.labels) if not keys or label_key(label) in keys])


def detect_closed_set(detector: ClosedSetDetector, image: Image, settings: PerceptionSettings) -> Detections:
    """Detects objects that score `score_floor`; with `closer_look`, also in the image's four corners."""
    if not settings.closer_look:
        return detector.detect(image, settings.score_floor)
    return _detect_in_crops(detector, image, settings.score_floor)


def _detect_in_crops(detector: ClosedSetDetector, image: Image, min_score: float) -> Detections:
    """Detects in the image and its four corners, without boxes cut off by a crop."""
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
    """Positions of at most `limit` of `total` views, evenly spread, with both ends; 0: all."""
    if not limit or limit >= total:
        return list(range(total))
    return sorted({round(position) for position in np.linspace(0, total - 1, limit)})


def check_labels_known(names: Sequence[str], settings: PerceptionSettings) -> None:
    """Checks, without opening models, that the configured detectors know these names.

    Raises:
        InvalidInputError: names those that the closed-set detector, in use alone, does not know.
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
