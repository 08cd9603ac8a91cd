"""GroundingDINO, an open-set detector prompted by label strings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL.Image import Resampling
from scipy.special import expit

from fastsplat.service.perception.detectors.prompted_boxes import (
    F32,
    IMAGENET,
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

_MAX_TOKENS = 256
_PROBE = "red chair"
_SAME = 0.02  # logits of equal phrases differ less; baked-in lengths of text move them by 0.06 and more


class GroundingDino:
    """Adapter of GroundingDINO's ONNX export (Liu et al. 2023).

    `pixel_values` [1, 3, S, S] (S is 800 if left open), `pixel_mask`, `input_ids`, `token_type_ids`, `attention_mask`
    → `logits` [1, Q, 256], `pred_boxes` [1, Q, 4] (center and size, of the whole image = 1). A prompt is phrases in
    lower case, each ended by a full stop; a phrase's score is the mean of σ(logit) over its tokens.

    Tracing bakes the number of phrases of the exporter's example into older exports: later phrases are scored wrongly.
    Opening probes how many are scored rightly, and a pass has no more.

    Args:
        tokenizer: its `tokenizer.json` (BERT's).

    Raises:
        ModelUnavailableError: a file is missing or breaks this contract.
    """

    def __init__(self, model: Path, tokenizer: Path, *, name: str, threads: int = 0) -> None:
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
        self._side = input_side(self._session, "pixel_values", 800)
        self.phrases_per_pass = _MAX_TOKENS
        self.phrases_per_pass = self._count_right_phrases()

    def detect(self, image: Image, prompts: Sequence[str], min_score: float) -> Detections:
        """Detects objects that score at least `min_score`; a box takes its best prompt.

        Raises:
            InvalidInputError: a prompt is longer than 256 tokens, or has no word.
        """
        pixels = normalized(antialiased(image, self._side, Resampling.BILINEAR), IMAGENET)
        extent = np.array(image.shape[1::-1] * 2, np.float32)
        passes = []
        for group in self._passes(prompts):
            logits, boxes, spans = self._run(pixels, group)
            scores = np.stack([expit(logits[:, span]).mean(1) for span in spans], axis=1)
            passes.append(select_boxes(corners(boxes) * extent, scores, group, min_score, image))
        return joined(passes)

    def _passes(self, prompts: Sequence[str]) -> list[list[str]]:
        """Groups prompts by what a pass holds and scores rightly."""
        groups: list[list[str]] = []
        room = 0
        for prompt in prompts:
            size = len(self._tokenizer.encode(_phrase(prompt), add_special_tokens=False).ids)
            if not groups or size > room or len(groups[-1]) == self.phrases_per_pass:
                groups.append([])
                room = _MAX_TOKENS - 2
            groups[-1].append(prompt)
            room -= size
        return groups

    def _count_right_phrases(self) -> int:
        """Counts equal phrases, from the first, with equal logits; without a wrong one, any number is right."""
        copies = self._passes([_PROBE] * _MAX_TOKENS)[0]
        logits, _, spans = self._run(np.zeros((1, 3, self._side, self._side), np.float32), copies)
        same = [np.abs(logits[:, span] - logits[:, spans[0]]).max() <= _SAME for span in spans]
        return _MAX_TOKENS if all(same) else same.index(False)

    def _run(self, pixels: F32, prompts: Sequence[str]) -> tuple[F32, F32, list[list[int]]]:
        """Logits [Q, 256] and boxes [Q, 4] of Q queries, and token positions of each phrase."""
        ids, spans = self._tokens(prompts)
        feed = {
            "pixel_values": pixels,
            "pixel_mask": np.ones((1, self._side, self._side), np.int64),
            "input_ids": ids,
            "token_type_ids": np.zeros_like(ids),
            "attention_mask": np.ones_like(ids),
        }
        logits, boxes = self._session.run(["logits", "pred_boxes"], feed)
        return logits[0], boxes[0], spans

    def _tokens(self, prompts: Sequence[str]) -> tuple[NDArray[np.int64], list[list[int]]]:
        """int64 [1, T] ids of "cup. red chair.", and token positions per phrase."""
        text, ranges = "", []
        for prompt in prompts:
            phrase = _phrase(prompt)
            ranges.append((len(text), len(text) + len(phrase) - 1))
            text += phrase + " "
        encoding = self._tokenizer.encode(text.strip())
        if len(encoding.ids) > _MAX_TOKENS:
            raise InvalidInputError(
                f'the label "{prompts[0][:100]}" is {len(encoding.ids)} tokens',
                field="labels",
                limit=f"{_MAX_TOKENS} tokens a label",
                hint="Use a shorter label.",
            )
        spans = [
            [i for i, (start, end) in enumerate(encoding.offsets) if start < end and first <= start and end <= last]
            for first, last in ranges
        ]
        for prompt, span in zip(prompts, spans, strict=True):
            if not span:
                raise InvalidInputError(f'the label "{prompt}" has no word the detector can read', field="labels")
        return np.asarray([encoding.ids], np.int64), spans


def _phrase(prompt: str) -> str:
    return " ".join(prompt.lower().replace(".", " ").split()) + "."
