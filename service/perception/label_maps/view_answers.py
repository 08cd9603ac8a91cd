"""A segmenter's answers for a view: masks of detected boxes, and masks without names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Detections, Image, MaskLogits, Segmenter, ViewMasks
from fastsplat.service.perception.segmenters.mask_postprocessing import upsampled
from fastsplat.service.perception.segmenters.mask_proposals import answer_boxes, boxes_to_prompt, propose_masks


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
