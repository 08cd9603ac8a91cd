"""GroundingDINO, an open-set detector prompted by label strings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from fastsplat.service.perception.box_ops import clip_boxes, nms
from fastsplat.service.perception.image_tensors import imagenet_tensor
from fastsplat.service.perception.onnx_session import check_contract, open_session
from fastsplat.service.perception.results import Detections, Image, joined
from fastsplat.service.perception.text.text_encoders import load_tokenizer
from fastsplat_contract.errors import InvalidInputError

_MAX_TOKENS = 256
_NMS_IOU = 0.6


class GroundingDino:
    """Adapter of GroundingDINO's ONNX export.

    `pixel_values` [1, 3, 800, 800], `pixel_mask`, `input_ids`, `token_type_ids`, `attention_mask` → `logits`
    [1, Q, 256], `pred_boxes` [1, Q, 4] (center and size, of the whole image = 1). The prompt is every phrase in lower
    case, ended by a full stop; its score is the mean of σ(logit) over its tokens.

    Args:
        tokenizer: its `tokenizer.json` (BERT's).
        prompts_per_pass: phrases in one prompt. The export of onnx-community was traced with a single phrase and scores
            only the first of several: use 1.

    Raises:
        ModelUnavailableError: a file is missing or breaks this contract.
    """

    def __init__(self, model: Path, tokenizer: Path, *, name: str, prompts_per_pass: int = 1, threads: int = 0) -> None:
        self._tokenizer = load_tokenizer(tokenizer, name=name)
        self._session = open_session(model, name=name, threads=threads)
        check_contract(
            self._session,
            name=name,
            inputs={
                "pixel_values": (1, 3, None, None),
                "pixel_mask": (1, None, None),
                "input_ids": (1, None),
                "token_type_ids": (1, None),
                "attention_mask": (1, None),
            },
            outputs={"logits": (1, None, None), "pred_boxes": (1, None, 4)},
        )
        shape = {node.name: node.shape for node in self._session.get_inputs()}["pixel_values"]
        self._side = shape[2] if isinstance(shape[2], int) else 800
        self._per_pass = prompts_per_pass

    def detect(self, image: Image, prompts: Sequence[str], min_score: float) -> Detections:
        """Detects objects that score at least `min_score`; a box takes its best prompt.

        Raises:
            InvalidInputError: a prompt is longer than 256 tokens.
        """
        pixels = imagenet_tensor(image, self._side)
        passes = [
            self._one_pass(image, pixels, prompts[start : start + self._per_pass], min_score)
            for start in range(0, len(prompts), self._per_pass)
        ]
        return joined(passes)

    def _one_pass(
        self, image: Image, pixels: NDArray[np.float32], prompts: Sequence[str], min_score: float
    ) -> Detections:
        height, width = image.shape[:2]
        ids, spans = self._tokens(prompts)
        feed = {
            "pixel_values": pixels,
            "pixel_mask": np.ones((1, self._side, self._side), np.int64),
            "input_ids": ids,
            "token_type_ids": np.zeros_like(ids),
            "attention_mask": np.ones_like(ids),
        }
        logits, pred_boxes = self._session.run(["logits", "pred_boxes"], feed)
        token_scores = expit(logits[0])  # 0 for the −inf of positions beyond the prompt
        scores = np.stack([token_scores[:, span].mean(1) for span in spans], axis=1)
        best, score = scores.argmax(1), scores.max(1).astype(np.float32)
        size = np.array([width, height], np.float32)
        center, extent = pred_boxes[0, :, :2] * size, pred_boxes[0, :, 2:] * size
        boxes = clip_boxes(np.concatenate([center - extent / 2, center + extent / 2], axis=1), width, height)
        rows: list[int] = []
        for label in range(len(prompts)):
            group = np.flatnonzero((best == label) & (score >= min_score))
            rows += group[nms(boxes[group], score[group], _NMS_IOU)].tolist()
        return Detections(boxes[rows], score[rows], tuple(prompts[best[row]] for row in rows))

    def _tokens(self, prompts: Sequence[str]) -> tuple[NDArray[np.int64], list[list[int]]]:
        """int64 [1, T] ids of "cup. red chair.", and token positions per phrase."""
        text, ranges = "", []
        for prompt in prompts:
            phrase = " ".join(prompt.lower().replace(".", " ").split())
            ranges.append((len(text), len(text) + len(phrase)))
            text += phrase + ". "
        encoding = self._tokenizer.encode(text.strip())
        if len(encoding.ids) > _MAX_TOKENS:
            raise InvalidInputError(
                f"the labels {', '.join(prompts)[:100]}… are {len(encoding.ids)} tokens together",
                field="labels",
                limit=f"{_MAX_TOKENS} tokens a pass",
                hint="Use shorter labels, or fewer in one pass.",
            )
        spans = [
            [i for i, (start, end) in enumerate(encoding.offsets) if start < end and first <= start and end <= last]
            for first, last in ranges
        ]
        for prompt, span in zip(prompts, spans, strict=True):
            if not span:
                raise InvalidInputError(f'the label "{prompt}" has no word the detector can read', field="labels")
        return np.asarray([encoding.ids], np.int64), spans
