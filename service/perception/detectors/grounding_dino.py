"""GroundingDINO, an open-set detector prompted by label strings."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, pairwise
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.special import expit

from fastsplat.service.perception.detectors.prompted_boxes import F32, TokenPrompted, select_boxes
from fastsplat.service.perception.image_tensors import IMAGENET
from fastsplat.service.perception.results import Detections, Image, joined
from fastsplat_contract.errors import InvalidInputError

_PROBE = "red chair"
_SAME = 0.02  # logits of equal phrases differ less; where the number of phrases was baked in, by 0.06 and more


class GroundingDino(TokenPrompted):
    """Adapter of GroundingDINO's ONNX export (Liu et al. 2023).

    `pixel_values` [1, 3, S, S], ImageNet-normalized, `pixel_mask`, `input_ids` (of BERT's tokenizer), `token_type_ids`,
    `attention_mask` → `logits` [1, Q, 256], `pred_boxes` [1, Q, 4] (the whole image = 1). The prompt is every phrase in
    lower case, ended by a full stop; its score is the mean of σ(logit) over its tokens.

    Tracing bakes the number of phrases of the exporter's example into some exports, which score later ones wrongly.
    Opening runs the network once to count what is right: `phrases_per_pass`.
    """

    inputs: ClassVar = {
        "pixel_values": (1, 3, None, None),
        "pixel_mask": (1, None, None),
        **dict.fromkeys(("input_ids", "token_type_ids", "attention_mask"), (1, None)),
    }
    preprocessing, max_tokens = IMAGENET.model_copy(update={"size": 800}), 256

    def __init__(self, model: Path, tokenizer: Path, *, name: str, threads: int = 0) -> None:
        super().__init__(model, tokenizer, name=name, threads=threads)
        self.phrases_per_pass = self.max_tokens
        self.phrases_per_pass = self._count_right_phrases()

    def detect(self, image: Image, prompts: Sequence[str], min_score: float) -> Detections:
        """Detects objects that score at least `min_score`; a box takes its best prompt.

        Raises:
            InvalidInputError: a prompt is longer than 256 tokens, or has no word.
        """
        pixels = self._preprocessing.tensor(image)
        extent = np.array(image.shape[1::-1] * 2, np.float32)
        passes = []
        for group in self._passes(prompts):
            logits, boxes, spans = self._look(pixels, group)
            scores = np.stack([expit(logits[:, span]).mean(1) for span in spans], axis=1)
            passes.append(select_boxes(boxes * extent, scores, group, min_score, image))
        return joined(passes)

    def _passes(self, prompts: Sequence[str]) -> list[list[str]]:
        """Groups prompts by what a pass holds and scores rightly."""
        groups: list[list[str]] = []
        room = 0
        for prompt in prompts:
            size = len(self._tokenizer.encode(_phrase(prompt), add_special_tokens=False).ids)
            if not groups or size > room or len(groups[-1]) == self.phrases_per_pass:
                groups.append([])
                room = self.max_tokens - 2  # [CLS] and [SEP]
            groups[-1].append(prompt)
            room -= size
        return groups

    def _count_right_phrases(self) -> int:
        """Counts equal phrases, from the first, with equal logits; without a wrong one, any number is right."""
        copies = self._passes([_PROBE] * self.max_tokens)[0]
        logits, _, spans = self._look(np.zeros((1, 3, self._side, self._side), np.float32), copies)
        same = [np.abs(logits[:, span] - logits[:, spans[0]]).max() <= _SAME for span in spans]
        return self.max_tokens if all(same) else same.index(False)

    def _look(self, pixels: F32, prompts: Sequence[str]) -> tuple[F32, F32, list[list[int]]]:
        """Logits and boxes as `_run`, and token positions of each phrase, of "cup. red chair."."""
        phrases = [_phrase(prompt) for prompt in prompts]
        encoding = self._encode(" ".join(phrases))
        starts = accumulate([len(phrase) + 1 for phrase in phrases], initial=0)
        spans = [
            [i for i, (start, end) in enumerate(encoding.offsets) if first <= start < end <= following - 2]
            for first, following in pairwise(starts)  # between them are also a full stop and a space
        ]
        for prompt, span in zip(prompts, spans, strict=True):
            if not span:
                raise InvalidInputError(f'the label "{prompt}" has no word the detector can read', field="labels")
        ids = np.asarray([encoding.ids], np.int64)
        feed = {
            "pixel_mask": np.ones((1, self._side, self._side), np.int64),
            "input_ids": ids,
            "token_type_ids": np.zeros_like(ids),
            "attention_mask": np.ones_like(ids),
        }
        return *self._run(pixels, feed), spans


def _phrase(prompt: str) -> str:
    return " ".join(prompt.lower().replace(".", " ").split()) + "."
