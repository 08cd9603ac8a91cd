"""OWL-ViT and OWLv2, open-set detectors prompted by label strings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from scipy import ndimage
from scipy.special import expit

from fastsplat.service.perception.detectors.prompted_boxes import F32, TokenPrompted, select_boxes
from fastsplat.service.perception.image_tensors import CLIP
from fastsplat.service.perception.results import Detections, Image, joined


class OwlViT(TokenPrompted):
    """Adapter of OWL-ViT's ONNX export (Minderer et al. 2022): all prompts in one pass.

    `input_ids`, `attention_mask` [N, 16] (of CLIP's tokenizer), `pixel_values` [1, 3, S, S], CLIP-normalized →
    `logits` [1, A, N], `pred_boxes` [1, A, 4] (the whole image = 1). A score is σ(logit).
    """

    inputs: ClassVar = {"input_ids": (None, None), "pixel_values": (1, 3, None, None), "attention_mask": (None, None)}
    preprocessing, max_tokens = CLIP.model_copy(update={"size": 768}), 16

    def detect(self, image: Image, prompts: Sequence[str], min_score: float) -> Detections:
        """Detects objects that score at least `min_score`; a box takes its best prompt.

        Raises:
            InvalidInputError: a prompt is longer than 16 tokens.
        """
        if not prompts:
            return joined([])
        ids, mask = np.zeros((2, len(prompts), self.max_tokens), np.int64)
        for row, prompt in enumerate(prompts):
            tokens = self._encode(prompt).ids
            ids[row, : len(tokens)], mask[row, : len(tokens)] = tokens, 1
        logits, boxes = self._run(self._pixels(image), {"input_ids": ids, "attention_mask": mask})
        return select_boxes(boxes * self._extent(image), expit(logits), prompts, min_score, image)

    def _pixels(self, image: Image) -> F32:
        return self._preprocessing.tensor(image)

    def _extent(self, image: Image) -> F32:
        """float32 [4]: what is 1 in boxes, in pixels."""
        return np.array(image.shape[1::-1] * 2, np.float32)


class OwlV2(OwlViT):
    """Adapter of OWLv2's ONNX export (Minderer et al. 2023).

    As `OwlViT`, but of a photo padded at right and bottom to a gray square, whose side is 1 in boxes.
    """

    preprocessing = CLIP.model_copy(update={"size": 960})

    def _pixels(self, image: Image) -> F32:
        square = np.full((max(image.shape), max(image.shape), 3), 0.5, np.float32)
        square[: image.shape[0], : image.shape[1]] = image / np.float32(255)
        # As scikit-image resizes, with which it was trained: smoothed by half of each pixel that is left out.
        factor = len(square) / self._side
        blur = max(0.0, (factor - 1) / 2)
        smooth = ndimage.gaussian_filter(square, (blur, blur, 0), mode="mirror")
        zoom = (1 / factor, 1 / factor, 1)
        small = ndimage.zoom(smooth, zoom, order=1, mode="mirror", grid_mode=True)
        return self._preprocessing.normalized(np.asarray(small, np.float32))

    def _extent(self, image: Image) -> F32:
        return np.full(4, max(image.shape), np.float32)
