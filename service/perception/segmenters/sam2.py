"""Segmenters with the SAM 2 ONNX contract (hiera exports with separate encoder and decoder)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.image_tensors import imagenet_tensor
from fastsplat.service.perception.onnx_session import check_contract, open_session
from fastsplat.service.perception.results import Image, MaskLogits, Prompts, box_prompts
from fastsplat.service.perception.segmenters.mask_postprocessing import select_mask

_SIDE = 1024
_FEATURES = ("high_res_feats_0", "high_res_feats_1", "image_embed")


@dataclass(frozen=True)
class _Embedding:
    features: dict[str, NDArray[np.float32]]
    height: int
    width: int


class Sam2:
    """Adapter of the SAM 2 ONNX contract.

    Encoder `image` [1, 3, 1024, 1024] (ImageNet-normalized, aspect not kept) → `high_res_feats_0`, `high_res_feats_1`,
    `image_embed`; decoder with these, points and an unused mask → `masks` [L, M, S, S] logits of the square image,
    `iou_predictions` [L, M]. Opening raises `ModelUnavailableError` if a file breaks this contract.
    """

    def __init__(self, encoder: Path, decoder: Path, *, name: str, threads: int = 0) -> None:
        self._encoder = open_session(encoder, name=name, threads=threads)
        self._decoder = open_session(decoder, name=name, threads=threads)
        maps = dict.fromkeys(_FEATURES, (1, None, None, None))
        check_contract(self._encoder, name=name, inputs={"image": (1, 3, _SIDE, _SIDE)}, outputs=maps)
        check_contract(
            self._decoder,
            name=name,
            inputs={
                **maps,
                "point_coords": (None, None, 2),
                "point_labels": (None, None),
                "mask_input": (None, 1, 256, 256),
                "has_mask_input": (None,),
            },
            optional_inputs=["orig_im_size"],
            outputs={"masks": (None, None, None, None), "iou_predictions": (None, None)},
        )
        self._sized = "orig_im_size" in {node.name for node in self._decoder.get_inputs()}

    def embed(self, image: Image) -> _Embedding:
        features = self._encoder.run(list(_FEATURES), {"image": imagenet_tensor(image, _SIDE)})
        return _Embedding(dict(zip(_FEATURES, features, strict=True)), image.shape[0], image.shape[1])

    def masks(self, embedding: _Embedding, boxes: NDArray[np.float32]) -> NDArray[np.bool_]:
        """bool [K, H, W] for float32 [K, 4] boxes in pixels of the image."""
        height, width = embedding.height, embedding.width
        result = np.zeros((len(boxes), height, width), np.bool_)
        for row, box in enumerate(boxes):
            answer = self.mask_logits(embedding, box_prompts(box[None]))
            layers = answer.logits[0]
            layer = layers[select_mask(layers, answer.quality[0], box * np.array(answer.scale * 2, np.float32))]
            result[row] = cv2.resize(layer, (width, height), interpolation=cv2.INTER_LINEAR) > 0
        return result

    def mask_logits(self, embedding: _Embedding, prompts: Prompts) -> MaskLogits:
        height, width = embedding.height, embedding.width
        stretch = np.array([_SIDE / width, _SIDE / height], np.float32)
        parts = []
        for row in range(len(prompts)):
            feed = {
                **embedding.features,
                "point_coords": prompts.points[row : row + 1] * stretch,
                "point_labels": prompts.kinds[row : row + 1],
                "mask_input": np.zeros((1, 1, 256, 256), np.float32),
                "has_mask_input": np.zeros(1, np.float32),
            }
            if self._sized:
                feed["orig_im_size"] = np.array([height, width], np.int32)
            parts.append(self._decoder.run(["masks", "iou_predictions"], feed))
        if not parts:
            return MaskLogits(
                np.zeros((0, 3, 256, 256), np.float32), np.zeros((0, 3), np.float32), (256 / width, 256 / height)
            )
        logits = np.concatenate([part[0] for part in parts])
        scale = (logits.shape[3] / width, logits.shape[2] / height)
        return MaskLogits(logits, np.concatenate([part[1] for part in parts]), scale)
