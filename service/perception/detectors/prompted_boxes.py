"""What open-set detectors share: prompts as tokens, and boxes with the best prompt each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from tokenizers import Encoding

from fastsplat.service.perception.box_ops import clip_boxes, nms
from fastsplat.service.perception.image_tensors import Preprocessing
from fastsplat.service.perception.onnx_session import Shape, check_contract, input_side, open_session
from fastsplat.service.perception.results import Detections, Image, joined
from fastsplat.service.perception.text.text_encoders import load_tokenizer
from fastsplat_contract.errors import InvalidInputError

F32 = NDArray[np.float32]

_NMS_IOU = 0.6  # of boxes with one label; rivals between labels are resolved by the caller


class TokenPrompted:
    """A network of images and tokens, with `logits` [1, A, N] and `pred_boxes` [1, A, 4], center and size.

    Args:
        tokenizer: its `tokenizer.json`.

    Raises:
        ModelUnavailableError: a file is missing or breaks the contract.
    """

    inputs: ClassVar[Mapping[str, Shape]]
    preprocessing: ClassVar[Preprocessing]
    """Of images, `pixel_values` [1, 3, size, size]; the size counts if the network leaves it open."""
    max_tokens: ClassVar[int]

    def __init__(self, model: Path, tokenizer: Path, *, name: str, threads: int = 0) -> None:
        self._tokenizer = load_tokenizer(tokenizer, name=name)
        self._session = open_session(model, name=name, threads=threads)
        outputs = {"logits": (1, None, None), "pred_boxes": (1, None, 4)}
        check_contract(self._session, name=name, inputs=self.inputs, outputs=outputs)
        self._side = input_side(self._session, "pixel_values", self.preprocessing.size)
        self._preprocessing = self.preprocessing.model_copy(update={"size": self._side})

    def _run(self, pixels: F32, feed: Mapping[str, NDArray[np.int64]]) -> tuple[F32, F32]:
        """Logits [A, N], and boxes [A, 4] by their corners, of normalized pixels [1, 3, S, S]."""
        logits, boxes = self._session.run(["logits", "pred_boxes"], {"pixel_values": pixels, **feed})
        return logits[0], corners(boxes[0])

    def _encode(self, text: str) -> Encoding:
        """Tokens of a text; too many raise `InvalidInputError`."""
        encoding = self._tokenizer.encode(text)
        if len(encoding.ids) > self.max_tokens:
            raise InvalidInputError(
                f'the label "{text[:100]}" is {len(encoding.ids)} tokens',
                field="labels",
                limit=f"{self.max_tokens} tokens a label",
                hint="Use a shorter label.",
            )
        return encoding


def corners(boxes: F32) -> F32:
    """Converts boxes [A, 4] from center and size to x1, y1, x2, y2."""
    center, half = boxes[:, :2], boxes[:, 2:] / 2
    return np.concatenate([center - half, center + half], 1)


def select_boxes(boxes: F32, scores: F32, prompts: Sequence[str], min_score: float, image: Image) -> Detections:
    """Gives boxes that score at least `min_score` their best prompt, without duplicates.

    Args:
        boxes: float32 [A, 4], x1, y1, x2, y2 in pixels of the image, to which they are clipped.
        scores: float32 [A, N], 0..1, of N prompts.
    """
    best, score = scores.argmax(1), scores.max(1).astype(np.float32)
    labels = tuple(prompts[label] for label in best)
    everything = Detections(clip_boxes(boxes, image.shape[1], image.shape[0]), score, labels)
    strong = np.flatnonzero(score >= min_score)
    groups = [strong[best[strong] == label] for label in np.unique(best[strong])]
    return joined([everything.take(rows[nms(everything.boxes[rows], score[rows], _NMS_IOU)]) for rows in groups])
