"""YOLO-World style open-set detectors, prompted by label embeddings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fastsplat.service.perception.box_ops import clip_boxes, nms
from fastsplat.service.perception.image_tensors import letterboxed
from fastsplat.service.perception.onnx_session import check_contract, open_session
from fastsplat.service.perception.results import Detections, Image, TextEncoder
from fastsplat_contract.errors import ModelUnavailableError

_NMS_IOU = 0.6  # of boxes with one label; rivals between labels are resolved by the caller


class YoloWorld:
    """Adapter of YOLO-World ONNX exports without non-maximum suppression.

    `images` [1, 3, S, S], `text_embeds` [1, N, E] → `boxes_xyxy` [1, A, 4], `scores` [1, A, N].

    Args:
        encoder: embeds prompts in the detector's space (CLIP ViT-B/32 for the public weights).

    Raises:
        ModelUnavailableError: the file breaks this contract, or, in `detect`, the encoder has another width.
    """

    def __init__(self, model: Path, encoder: TextEncoder, *, name: str, threads: int = 0) -> None:
        self._session = open_session(model, name=name, threads=threads)
        check_contract(
            self._session,
            name=name,
            inputs={"images": (1, 3, None, None), "text_embeds": (1, None, None)},
            outputs={"boxes_xyxy": (1, None, 4), "scores": (1, None, None)},
        )
        shapes = {node.name: node.shape for node in self._session.get_inputs()}
        self._side = shapes["images"][2] if isinstance(shapes["images"][2], int) else 640
        self._width = shapes["text_embeds"][2]
        self._encoder = encoder
        self._name = name

    def detect(self, image: Image, prompts: Sequence[str], min_score: float) -> Detections:
        """Detects objects that score at least `min_score`; a box takes its best prompt.

        Raises:
            InvalidInputError: the encoder does not know a prompt (label tables).
        """
        height, width = image.shape[:2]
        tensor, frame = letterboxed(image, self._side)
        embeddings = self._encoder.encode(prompts)
        if isinstance(self._width, int) and embeddings.shape[1] != self._width:
            raise ModelUnavailableError(
                f"model {self._name} takes embeddings of {self._width} numbers; {self._encoder.name} gives "
                f"{embeddings.shape[1]}",
                field="perception.prompt_encoder",
                hint="Choose the text encoder that the detector was trained with.",
            )
        outputs = ["boxes_xyxy", "scores"]
        boxes, scores = self._session.run(outputs, {"images": tensor, "text_embeds": embeddings[None]})
        best = scores[0].argmax(1)
        score = scores[0].max(1).astype(np.float32)
        rows = np.flatnonzero(score >= min_score)
        winners = [
            rows[best[rows] == label][nms(boxes[0, group], score[group], _NMS_IOU)]
            for label in np.unique(best[rows])
            for group in [rows[best[rows] == label]]
        ]
        rows = np.concatenate(winners) if winners else np.zeros(0, np.intp)
        rows = rows[np.argsort(-score[rows], kind="stable")]
        return Detections(
            clip_boxes(frame.to_image(boxes[0, rows]), width, height),
            score[rows],
            tuple(prompts[label] for label in best[rows]),
        )
