"""OWL-ViT and OWLv2, open-set detectors prompted by label strings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL.Image import Resampling
from scipy import ndimage
from scipy.special import expit

from fastsplat.service.perception.detectors.prompted_boxes import (
    CLIP,
    F32,
    antialiased,
    corners,
    input_side,
    normalized,
    select_boxes,
)
from fastsplat.service.perception.onnx_session import check_contract, open_session
from fastsplat.service.perception.results import Detections, Image, joined
from fastsplat.service.perception.text.text_encoders import load_tokenizer
from fastsplat_contract.errors import InvalidInputError

_MAX_TOKENS = 16


class OwlViT:
    """Adapter of OWL-ViT's ONNX export (Minderer et al. 2022).

    `input_ids`, `attention_mask` [N, 16], `pixel_values` [1, 3, S, S], CLIP-normalized → `logits` [1, A, N],
    `pred_boxes` [1, A, 4] (center and size, of the whole image = 1). A score is σ(logit).

    Args:
        tokenizer: its `tokenizer.json` (CLIP's).

    Raises:
        ModelUnavailableError: a file is missing or breaks this contract.
    """

    side = 768  # of pictures if the network does not tell

    def __init__(self, model: Path, tokenizer: Path, *, name: str, threads: int = 0) -> None:
        self._tokenizer = load_tokenizer(tokenizer, name=name)
        self._session = open_session(model, name=name, threads=threads)
        check_contract(
            self._session,
            name=name,
            inputs={"input_ids": (None, None), "pixel_values": (1, 3, None, None), "attention_mask": (None, None)},
            outputs={"logits": (1, None, None), "pred_boxes": (1, None, 4)},
        )
        self._side = input_side(self._session, "pixel_values", self.side)

    def detect(self, image: Image, prompts: Sequence[str], min_score: float) -> Detections:
        """Detects objects that score at least `min_score`; a box takes its best prompt.

        Raises:
            InvalidInputError: a prompt is longer than 16 tokens.
        """
        if not prompts:
            return joined([])
        tokens = [self._tokenizer.encode(prompt).ids for prompt in prompts]
        ids, mask = np.zeros((2, len(prompts), _MAX_TOKENS), np.int64)
        for row, (prompt, found) in enumerate(zip(prompts, tokens, strict=True)):
            if len(found) > _MAX_TOKENS:
                raise InvalidInputError(
                    f'the label "{prompt[:100]}" is {len(found)} tokens',
                    field="labels",
                    limit=f"{_MAX_TOKENS} tokens a label",
                    hint="Use a shorter label.",
                )
            ids[row, : len(found)], mask[row, : len(found)] = found, 1
        feed = {"input_ids": ids, "pixel_values": normalized(self._pixels(image), CLIP), "attention_mask": mask}
        logits, boxes = self._session.run(["logits", "pred_boxes"], feed)
        return select_boxes(corners(boxes[0]) * self._extent(image), expit(logits[0]), prompts, min_score, image)

    def _pixels(self, image: Image) -> F32:
        """float32 [S, S, 3] in 0..1."""
        return antialiased(image, self._side, Resampling.BICUBIC)

    def _extent(self, image: Image) -> F32:
        """float32 [4]: pixels that boxes take as 1."""
        return np.array(image.shape[1::-1] * 2, np.float32)


class OwlV2(OwlViT):
    """Adapter of OWLv2's ONNX export (Minderer et al. 2023).

    As `OwlViT`, but of a photo padded at right and bottom to a gray square, whose side is 1 in boxes.
    """

    side = 960

    def _pixels(self, image: Image) -> F32:
        square = np.full((max(image.shape), max(image.shape), 3), 0.5, np.float32)
        square[: image.shape[0], : image.shape[1]] = image / np.float32(255)
        # As scikit-image resizes, with which it was trained: smoothed by half a pixel for each that is left out.
        factor = len(square) / self._side
        blur = max(0.0, (factor - 1) / 2)
        smooth = ndimage.gaussian_filter(square, (blur, blur, 0), mode="mirror")
        zoom = (1 / factor, 1 / factor, 1)
        return np.asarray(ndimage.zoom(smooth, zoom, order=1, mode="mirror", grid_mode=True), np.float32)

    def _extent(self, image: Image) -> F32:
        return np.full(4, max(image.shape), np.float32)
