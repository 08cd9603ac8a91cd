"""What a segmenter answers in one view: masks without names, and the masks of what a detector has boxes of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.mask_postprocessing import upsampled
from fastsplat.service.perception.mask_proposals import answer_boxes, boxes_to_prompt, propose_masks
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.types import Detections, Image, MaskLogits, Segmenter, ViewMasks


@dataclass(frozen=True)
class ViewAnswers:
    """The answers to all prompts of one view.

    Attributes:
        answer: the best answer to each of K boxes, see `answer_boxes`: first those of the objects.
        size: height and width of the image.
    """

    answer: MaskLogits
    size: tuple[int, int]
    masks: ViewMasks

    def masks_of_first(self, count: int) -> NDArray[np.bool_]:
        """bool [count, H, W]: the answers to the first boxes."""
        height, width = self.size
        return upsampled(self.answer.logits[:count, 0], self.answer.scale, self.size, width, height)


def look_at_view(
    segmenter: Segmenter, image: Image, objects: Detections, candidates: Detections, settings: PerceptionSettings
) -> ViewAnswers:
    """Prompt a segmenter with what was detected in a view, and then where nothing was.

    Args:
        image: uint8 [H, W, 3].
        candidates: all others that may be objects.
    """
    embedding, size = segmenter.embed(image), (image.shape[0], image.shape[1])
    boxes = boxes_to_prompt(objects, candidates, settings)
    answer = answer_boxes(segmenter, embedding, boxes)
    return ViewAnswers(answer, size, propose_masks(segmenter, embedding, answer, size, settings))
