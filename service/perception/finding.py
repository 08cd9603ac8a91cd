"""Which detector looks for what, over a whole capture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from fastsplat.service.common.dictionary import dictionary_of, label_key
from fastsplat.service.perception.detectors import open_closed_set_detector, open_open_set_detector
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.tags import TAGS
from fastsplat.service.perception.types import ClosedSetDetector, Detections, Image, joined
from fastsplat.service.perception.votes import one_name_each, settle
from fastsplat_contract.errors import InvalidInputError

_WINDOW = 0.6
_CUT_PX = 4

Load = Callable[[int], Image]
"""Loads the image of a position among the views that perception looks at."""

Seen = Callable[[int, str], None]
"""Told the number of views done in this pass and a line for people; may raise `CancelledError`."""


def find(
    load: Load, count: int, labels: Sequence[str], settings: PerceptionSettings, models: Path, seen: Seen
) -> list[Detections]:
    """Raw detections of every view, scoring the settings' floor at least, with one name per kind.

    With an open-set detector: prompted by the user's labels, else by what `settings.prompt_source` says. Without:
    what the closed-set detector finds, of the user's labels only if there are any.

    Raises:
        InvalidInputError: the closed-set detector cannot know some of the labels; names them.
        ModelUnavailableError: see the detectors.
    """
    names = [entry.label for entry in dictionary_of(labels).entries]
    if not settings.open_set_detector:
        closed = open_closed_set_detector(settings, models)
        _refuse_unknown(names, closed, settings)
        return _closed_pass(closed, load, count, names, settings, seen)
    prompts = names or _prompts(load, count, settings, models, seen)
    detector = open_open_set_detector(settings, models)
    found = []
    for view in range(count):
        found.append(detector.detect(load(view), prompts, settings.open_score_floor))
        seen(view + 1, f"looking for {len(prompts)} kinds of things, view {view + 1}/{count}")
    return one_name_each(found, prompts)


def _prompts(load: Load, count: int, settings: PerceptionSettings, models: Path, seen: Seen) -> list[str]:
    if settings.prompt_source == "closed_set":
        closed = open_closed_set_detector(settings, models)
        settled, _ = settle(_closed_pass(closed, load, count, [], settings, seen), settings, named=False)
        finds = dict.fromkeys(label for view in settled for label in view.labels)
        if finds:
            return list(finds)
    return list(settings.tags or TAGS)


def _closed_pass(
    detector: ClosedSetDetector, load: Load, count: int, names: Sequence[str], settings: PerceptionSettings, seen: Seen
) -> list[Detections]:
    wanted = {label_key(name) for name in names}
    found = []
    for view in range(count):
        image = load(view)
        look = _closer_look if settings.closer_look else _plain_look
        everything = look(detector, image, settings.score_floor)
        rows = [i for i, label in enumerate(everything.labels) if not wanted or label_key(label) in wanted]
        found.append(everything.take(rows))
        seen(view + 1, f"looking for things, view {view + 1}/{count}")
    return one_name_each(found, names)


def _plain_look(detector: ClosedSetDetector, image: Image, min_score: float) -> Detections:
    return detector.detect(image, min_score)


def _closer_look(detector: ClosedSetDetector, image: Image, min_score: float) -> Detections:
    """What the detector finds in the whole image and in its four corners, each _WINDOW of the sides; a box that ends
    where its corner ends, inside the image, is a cut thing and does not count."""
    height, width = image.shape[:2]
    tall, wide = round(height * _WINDOW), round(width * _WINDOW)
    parts = [detector.detect(image, min_score)]
    for top in (0, height - tall):
        for left in (0, width - wide):
            found = detector.detect(np.ascontiguousarray(image[top : top + tall, left : left + wide]), min_score)
            boxes = found.boxes + np.array([left, top, left, top], np.float32)
            inner = np.array([left, top, left + wide, top + tall], np.float32)
            outer = np.array([0, 0, width, height], np.float32)
            cut = (np.abs(boxes - inner) < _CUT_PX) & (inner != outer)
            whole = np.flatnonzero(~cut.any(1))
            parts.append(Detections(boxes, found.scores, found.labels).take(whole))
    return joined(parts)


def _refuse_unknown(names: Sequence[str], detector: ClosedSetDetector, settings: PerceptionSettings) -> None:
    known = {label_key(label) for label in detector.labels}
    unknown = [name for name in names if label_key(name) not in known]
    if unknown:
        raise InvalidInputError(
            f"the closed-set detector {settings.closed_set_detector} cannot know: {', '.join(unknown)}",
            field="labels",
            hint="Configure an open-set detector (FASTSPLAT_PERCEPTION__OPEN_SET_DETECTOR), or leave these labels out.",
        )
