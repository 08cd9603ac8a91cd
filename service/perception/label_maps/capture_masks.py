"""Masks without names: of one view's prompts, and of captures that no models label."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.build import load_image
from fastsplat.service.capture.captures import View
from fastsplat.service.capture.formats.capture_files import load_content
from fastsplat.service.perception.detectors.open_detectors import open_closed_set_detector
from fastsplat.service.perception.label_maps.capture_detection import detect_closed_set, spread
from fastsplat.service.perception.label_maps.side_by_side import in_order, side_by_side
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import ClosedSetDetector, Detections, Image, MaskLogits, Segmenter, ViewMasks
from fastsplat.service.perception.segmenters.mask_postprocessing import upsampled
from fastsplat.service.perception.segmenters.mask_proposals import answer_boxes, boxes_to_prompt, propose_masks
from fastsplat.service.perception.segmenters.open_segmenter import open_segmenter


@dataclass(frozen=True)
class ViewAnswers:
    """Answers to all prompts of a view."""

    answer: MaskLogits  # the best to each of K boxes, see `answer_boxes`, the objects' first
    size: tuple[int, int]  # height and width of the image
    masks: ViewMasks

    def masks_of_first(self, count: int) -> NDArray[np.bool_]:
        """bool [count, H, W]: the answers to the first boxes."""
        height, width = self.size
        return upsampled(self.answer.logits[:count, 0], self.answer.scale, self.size, width, height)


def look_at_view(
    segmenter: Segmenter, image: Image, objects: Detections, candidates: Detections, settings: PerceptionSettings
) -> ViewAnswers:
    """Prompts a segmenter by objects and other candidates of a view, then elsewhere."""
    embedding, size = segmenter.embed(image), (image.shape[0], image.shape[1])
    boxes = boxes_to_prompt(objects, candidates, settings)
    answer = answer_boxes(segmenter, embedding, boxes)
    return ViewAnswers(answer, size, propose_masks(segmenter, embedding, answer, size, settings))


OnView = Callable[[int, int], None]
"""Called with the number of views done and their total; may raise `CancelledError`."""


def propose_capture_masks(
    views: Sequence[View], settings: PerceptionSettings, models: Path, on_view: OnView = lambda done, total: None
) -> tuple[ViewMasks | None, ...]:
    """Proposes masks in at most `proposal_views` evenly spread views; None for the others.

    Raises:
        ModelUnavailableError: the closed-set detector or the segmenter is missing or damaged.
    """
    _, of_each = side_by_side(settings)
    detector, segmenter = open_closed_set_detector(of_each, models), open_segmenter(of_each, models)
    return propose_view_masks(views, detector, segmenter, settings, on_view)


def propose_view_masks(
    views: Sequence[View],
    detector: ClosedSetDetector,
    segmenter: Segmenter,
    settings: PerceptionSettings,
    on_view: OnView = lambda done, total: None,
) -> tuple[ViewMasks | None, ...]:
    """Proposes masks as `propose_capture_masks`, by these models; the detector's labels are ignored."""
    positions = spread(len(views), settings.proposal_views)
    masks: list[ViewMasks | None] = [None] * len(views)

    def look(position: int) -> ViewMasks:
        image = load_image(views[position])
        detections = detect_closed_set(detector, image, settings)
        proposed = look_at_view(segmenter, image, detections.take([]), detections, settings).masks
        content = load_content(views[position])
        return proposed if content is None else proposed.within(content)

    at_once, _ = side_by_side(settings)
    for done, (position, found) in enumerate(zip(positions, in_order(look, positions, at_once), strict=True), start=1):
        masks[position] = found
        on_view(done, len(positions))
    return tuple(masks)
