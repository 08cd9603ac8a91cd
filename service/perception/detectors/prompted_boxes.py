"""Pixels for open-set detectors, and their boxes with the best prompt each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import onnxruntime
from numpy.typing import NDArray
from PIL import Image as PillowImage

from fastsplat.service.perception.box_ops import clip_boxes, nms
from fastsplat.service.perception.results import Detections, Image, joined

F32 = NDArray[np.float32]

IMAGENET = np.array([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]], np.float32)
CLIP = np.array([[0.48145466, 0.4578275, 0.40821073], [0.26862954, 0.26130258, 0.27577711]], np.float32)
"""Mean and standard deviation of a network's training photos, [2, 3]."""

_NMS_IOU = 0.6  # of boxes with one label; rivals between labels are resolved by the caller


def input_side(session: onnxruntime.InferenceSession, name: str, default: int) -> int:
    """Returns the height of a session's images, [N, 3, H, W], or `default` if it leaves it open."""
    side = {node.name: node.shape for node in session.get_inputs()}[name][2]
    return side if isinstance(side, int) else default


def antialiased(image: Image, side: int, how: PillowImage.Resampling) -> F32:
    """float32 [side, side, 3] in 0..1, resized without keeping the aspect."""
    return np.asarray(PillowImage.fromarray(image).resize((side, side), how), np.float32) / np.float32(255)


def normalized(pixels: F32, statistics: F32) -> F32:
    """float32 [1, 3, S, S] of pixels [S, S, 3] in 0..1; statistics as `CLIP`."""
    return np.ascontiguousarray(((pixels - statistics[0]) / statistics[1]).transpose(2, 0, 1)[None])


def corners(boxes: F32) -> F32:
    """Converts boxes [..., 4] from center and size to x1, y1, x2, y2."""
    center, half = boxes[..., :2], boxes[..., 2:] / 2
    return np.concatenate([center - half, center + half], -1)


def select_boxes(boxes: F32, scores: F32, prompts: Sequence[str], min_score: float, image: Image) -> Detections:
    """Gives boxes that score at least `min_score` their best prompt, without duplicates.

    Args:
        boxes: float32 [A, 4], x1, y1, x2, y2 in pixels of the image, to which they are clipped.
        scores: float32 [A, N], 0..1, of N prompts.
    """
    best, score = scores.argmax(1), scores.max(1).astype(np.float32)
    everything = Detections(
        clip_boxes(boxes, image.shape[1], image.shape[0]), score, tuple(prompts[label] for label in best)
    )
    strong = np.flatnonzero(score >= min_score)
    groups = [strong[best[strong] == label] for label in np.unique(best[strong])]
    return joined([everything.take(rows[nms(everything.boxes[rows], score[rows], _NMS_IOU)]) for rows in groups])
