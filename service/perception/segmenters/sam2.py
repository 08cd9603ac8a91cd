"""Segmenters with the SAM 2 ONNX contract (hiera exports with separate encoder and decoder)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.image_tensors import imagenet_tensor
from fastsplat.service.perception.onnx_session import check_contract, open_session
from fastsplat.service.perception.segmenters.mask_selection import select_mask
from fastsplat.service.perception.types import Image

_SIDE = 1024
_FEATURES = ("high_res_feats_0", "high_res_feats_1", "image_embed")


@dataclass(frozen=True)
class _Embedding:
    features: dict[str, NDArray[np.float32]]
    height: int
    width: int


class Sam2:
    """Encoder `image` [1, 3, 1024, 1024] (ImageNet-normalized, aspect not kept) → `high_res_feats_0`,
    `high_res_feats_1`, `image_embed`; decoder with these, points and an unused mask → `masks` [L, M, S, S] logits of
    the square image, `iou_predictions` [L, M].

    Raises:
        ModelUnavailableError: on opening, when a file does not keep this contract.
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
        """Features of uint8 [H, W, 3]."""
        features = self._encoder.run(list(_FEATURES), {"image": imagenet_tensor(image, _SIDE)})
        return _Embedding(dict(zip(_FEATURES, features, strict=True)), image.shape[0], image.shape[1])

    def masks(self, embedding: _Embedding, boxes: NDArray[np.float32]) -> NDArray[np.bool_]:
        """bool [K, H, W] for float32 [K, 4] boxes in pixels of the image."""
        height, width = embedding.height, embedding.width
        stretch = np.array([_SIDE / width, _SIDE / height], np.float32)
        result = np.zeros((len(boxes), height, width), np.bool_)
        for row, box in enumerate(boxes):
            feed = {
                **embedding.features,
                "point_coords": (box.reshape(1, 2, 2) * stretch).astype(np.float32),
                "point_labels": np.array([[2, 3]], np.float32),
                "mask_input": np.zeros((1, 1, 256, 256), np.float32),
                "has_mask_input": np.zeros(1, np.float32),
            }
            if self._sized:
                feed["orig_im_size"] = np.array([height, width], np.int32)
            logits, quality = self._decoder.run(["masks", "iou_predictions"], feed)
            layers = logits[0]
            grid = np.array([layers.shape[2] / width, layers.shape[1] / height] * 2, np.float32)
            layer = layers[select_mask(layers, quality[0], box * grid)]
            result[row] = cv2.resize(layer, (width, height), interpolation=cv2.INTER_LINEAR) > 0
        return result
