"""What a segmenter answers in one view: masks without names, and the masks of what a detector has boxes of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.box_ops import box_iou
from fastsplat.service.perception.mask_postprocessing import upsampled
from fastsplat.service.perception.mask_proposals import answer_boxes, boxes_to_prompt, propose_masks
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.types import Detections, Image, MaskLogits, Segmenter, ViewMasks


@dataclass(frozen=True)
class ViewAnswers:
    """The answers to all prompts of one view. Which boxes are objects may be decided afterwards.

    Attributes:
        boxes: float32 [K, 4], those that were prompted.
        answer: the best answer to each, see `answer_boxes`.
        size: height and width of the image.
        masks: see `propose_masks`.
    """

    boxes: NDArray[np.float32]
    answer: MaskLogits
    size: tuple[int, int]
    masks: ViewMasks

    def masks_of(self, boxes: NDArray[np.float32]) -> NDArray[np.bool_]:
        """bool [N, H, W] for boxes [N, 4] of the view: of each the answer to itself, or, where it was left out beside a
        better one in its place (`boxes_to_prompt`), to that."""
        rows = box_iou(boxes, self.boxes).argmax(axis=1) if len(boxes) else np.zeros(0, np.intp)
        return upsampled(self.answer.logits[rows, 0], self.answer.scale, self.size, self.size[1], self.size[0])


def look_at_view(
    segmenter: Segmenter, image: Image, objects: Detections, candidates: Detections, settings: PerceptionSettings
) -> ViewAnswers:
    """Prompt a segmenter with what was detected in a view, and then where nothing was.

    Args:
        segmenter: answers prompts.
        image: uint8 [H, W, 3].
        objects: detections whose very boxes are prompted; none where it is not known yet which ones stand.
        candidates: all others that may be objects.
        settings: the bounds.
    """
    embedding, size = segmenter.embed(image), (image.shape[0], image.shape[1])
    boxes = boxes_to_prompt(objects, candidates, settings)
    answer = answer_boxes(segmenter, embedding, boxes)
    return ViewAnswers(boxes, answer, size, propose_masks(segmenter, embedding, answer, size, settings))
