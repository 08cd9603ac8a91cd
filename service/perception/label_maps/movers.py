"""Redaction masks of people and other moving objects in photos, by the configured detectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.photos.withholding import Withholding, dilated
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.perception.detectors.open_detectors import (
    check_open_set_detector,
    check_texts_known,
    closed_set_labels,
    of_open_set,
    open_closed_set_detector,
    open_open_set_detector,
)
from fastsplat.service.perception.label_maps.capture_detection import detect_closed_set
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import (
    ClosedSetDetector,
    Detections,
    Image,
    OpenSetDetector,
    Segmenter,
    joined,
)
from fastsplat.service.perception.segmenters.mask_postprocessing import clean_mask, upsampled
from fastsplat.service.perception.segmenters.mask_proposals import answer_boxes
from fastsplat.service.perception.segmenters.open_segmenter import open_segmenter
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError
from fastsplat_contract.jobs.operations import Movers, Privacy

_MOVER_MARGIN = 0.01  # dilation of withheld masks, as a share of the photo's longer side

_MIN_FILL = 0.25
_MIN_EXTENT = 0.5
_LEAST_MARGIN_PX = 4  # least dilation, as the edges of a segmenter's grid masks are not more accurate


@dataclass(frozen=True)
class MoverDetectors:
    """Words that each detector is asked for; without any it is not used."""

    closed_set: tuple[str, ...]
    open_set: tuple[str, ...]


def mover_detectors(
    movers: Movers | None, privacy: Privacy | None, settings: PerceptionSettings, models: Path
) -> MoverDetectors:
    """Assigns the words to withhold to every detector that knows them, without opening networks.

    Raises:
        ModelUnavailableError: names the words that no configured detector knows.
    """
    words = (*(settings.people_words if privacy else ()), *(settings.mover_words if movers == "ignore" else ()))
    words = tuple(dict.fromkeys(words))
    known = {label_key(label) for label in closed_set_labels(settings)}
    closed = tuple(word for word in words if label_key(word) in known)
    open_set = words if settings.open_set_detector and _open_set_knows(words, settings, models) else ()
    unknown = [word for word in words if word not in closed and word not in open_set]
    if unknown:
        raise ModelUnavailableError(
            f"no configured detector knows what is to be withheld: {', '.join(unknown)}",
            field="privacy" if privacy else "movers",
            hint="Configure one that does: FASTSPLAT_PERCEPTION__CLOSED_SET_DETECTOR or "
            "FASTSPLAT_PERCEPTION__OPEN_SET_DETECTOR, for the API and its workers.",
        )
    return MoverDetectors(closed, open_set)


def open_withholding(
    movers: Movers | None, privacy: Privacy | None, settings: PerceptionSettings, models: Path
) -> Withholding | None:
    """Opens the models that find what to leave out of photos; None if nothing is.

    Raises:
        ModelUnavailableError: a needed model is missing or damaged, or none knows a word.
    """
    if privacy is None and movers != "ignore":
        return None
    detectors = mover_detectors(movers, privacy, settings, models)
    closed = open_closed_set_detector(settings, models) if detectors.closed_set else None
    open_set = open_open_set_detector(settings, models) if detectors.open_set else None
    return Withholding(MoverMasks(detectors, closed, open_set, open_segmenter(settings, models), settings), privacy)


@dataclass(frozen=True)
class MoverMasks:
    """A `FindMovers` by detectors and a segmenter, in doubt withholding too much.

    Low scores count, masks are dilated, and the whole box counts if a mask hardly fills it. Detectors are None if not
    used.
    """

    words: MoverDetectors
    closed_set: ClosedSetDetector | None
    open_set: OpenSetDetector | None
    segmenter: Segmenter
    settings: PerceptionSettings

    def __call__(self, pixels: Image) -> NDArray[np.bool_]:
        """bool [H, W], True where a detector sees one of its words."""
        height, width = pixels.shape[:2]
        boxes = self._detections(pixels).boxes
        movers = np.zeros((height, width), np.bool_)
        if boxes.size == 0:
            return movers
        answer = answer_boxes(self.segmenter, self.segmenter.embed(pixels), boxes)
        masks = upsampled(answer.logits[:, 0], answer.scale, (height, width), width, height)
        for box, mask in zip(boxes, masks, strict=True):
            movers |= mask | clean_mask(mask)
            left, top = (max(0, int(np.floor(value))) for value in box[:2])
            right, bottom = int(np.ceil(box[2])), int(np.ceil(box[3]))
            if not _covers(mask[top:bottom, left:right]):
                movers[top:bottom, left:right] = True
        return dilated(movers, max(_LEAST_MARGIN_PX, round(_MOVER_MARGIN * max(height, width))))

    def _detections(self, pixels: Image) -> Detections:
        parts = []
        if self.closed_set is not None:
            everything = detect_closed_set(self.closed_set, pixels, self.settings)
            words = {label_key(word) for word in self.words.closed_set}
            parts.append(
                everything.take([row for row, label in enumerate(everything.labels) if label_key(label) in words])
            )
        if self.open_set is not None:
            parts.append(self.open_set.detect(pixels, self.words.open_set, of_open_set(self.settings).score_floor))
        return joined(parts)


def _covers(inside: NDArray[np.bool_]) -> bool:
    """True if a mask, cut to its box, is plausibly the whole object."""
    rows, columns = inside.any(1), inside.any(0)
    if not inside.size or inside.mean() < _MIN_FILL:
        return False
    return all(np.ptp(np.flatnonzero(line)) + 1 >= _MIN_EXTENT * line.size for line in (rows, columns))


def _open_set_knows(words: Sequence[str], settings: PerceptionSettings, models: Path) -> bool:
    check_open_set_detector(settings)
    try:
        check_texts_known(words, settings, models, field="privacy")
    except InvalidInputError:
        return False
    return True
