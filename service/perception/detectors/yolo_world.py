"""YOLO-World style open-set detectors, prompted by label embeddings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fastsplat.service.perception.detectors.prompted_boxes import corners, select_boxes
from fastsplat.service.perception.image_tensors import letterboxed
from fastsplat.service.perception.onnx_session import Shape, find_contract, input_side, open_session
from fastsplat.service.perception.results import Detections, Image, TextEncoder, joined
from fastsplat_contract.errors import ModelUnavailableError

_OUTPUTS: Mapping[str, Mapping[str, Shape]] = {
    "txt_feats": {"output0": (1, None, None)},
    "text_embeds": {"boxes_xyxy": (1, None, 4), "scores": (1, None, None)},
}
"""Outputs by the input of prompts, which names the contract."""
_INPUTS = {prompts: {"images": (1, 3, None, None), prompts: (1, None, None)} for prompts in _OUTPUTS}


class YoloWorld:
    """Adapter of YOLO-World ONNX exports without non-maximum suppression (Cheng et al. 2024).

    `images` [1, 3, S, S] (S is 640 if left open) and, by the file's own names, `txt_feats` [1, N, E] → `output0`
    [1, 4 + N, A], center, size and scores, or `text_embeds` [1, N, E] → `boxes_xyxy` [1, A, 4], `scores` [1, A, N].

    Args:
        encoder: embeds prompts in the detector's space (CLIP ViT-B/32 for the public weights).

    Raises:
        ModelUnavailableError: the file breaks these contracts, or, in `detect`, the encoder has another width.
    """

    def __init__(self, model: Path, encoder: TextEncoder, *, name: str, threads: int = 0) -> None:
        self._session = open_session(model, name=name, threads=threads)
        shapes = {node.name: node.shape for node in self._session.get_inputs()}
        if list(shapes) == ["images"]:
            raise ModelUnavailableError(
                f"model {name} takes images alone: its words were baked in at export, so it is a closed set",
                field=name,
                hint="Use an export that takes embeddings of words: images and txt_feats, or images and text_embeds.",
            )
        self._prompts = find_contract(
            self._session, {key: (_INPUTS[key], _OUTPUTS[key]) for key in _OUTPUTS}, name=name
        )
        self._side = input_side(self._session, "images", 640)
        self._width = shapes[self._prompts][2]
        self._encoder = encoder
        self._name = name

    def detect(self, image: Image, prompts: Sequence[str], min_score: float) -> Detections:
        """Detects objects that score at least `min_score`; a box takes its best prompt.

        Raises:
            InvalidInputError: the encoder does not know a prompt (label tables).
        """
        if not prompts:
            return joined([])
        tensor, frame = letterboxed(image, self._side)
        embeddings = self._encoder.encode(prompts)
        if isinstance(self._width, int) and embeddings.shape[1] != self._width:
            raise ModelUnavailableError(
                f"model {self._name} takes embeddings of {self._width} numbers; {self._encoder.name} gives "
                f"{embeddings.shape[1]}",
                field="perception.prompt_encoder",
                hint="Choose the text encoder that the detector was trained with.",
            )
        outputs = self._session.run(list(_OUTPUTS[self._prompts]), {"images": tensor, self._prompts: embeddings[None]})
        if self._prompts == "txt_feats":
            rows = outputs[0][0].T
            boxes, scores = corners(rows[:, :4]), rows[:, 4:]
        else:
            boxes, scores = outputs[0][0], outputs[1][0]
        return select_boxes(frame.to_image(boxes), scores, prompts, min_score, image)
