"""Segmenters with the original Segment-Anything ONNX contract (SAM, MobileSAM, EdgeSAM exports)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.image_tensors import long_side_padded
from fastsplat.service.perception.onnx_session import check_contract, open_session
from fastsplat.service.perception.segmenters.mask_selection import select_mask
from fastsplat.service.perception.types import Image

_SIDE = 1024
_MEAN = np.array([123.675, 116.28, 103.53], np.float32)
_BOX_CORNERS = np.array([[2, 3]], np.float32)  # the contract's point labels of a box


@dataclass(frozen=True)
class _Embedding:
    features: NDArray[np.float32]
    scale: float
    height: int
    width: int


class Sam1:
    """Encoder `image` [1, 3, 1024, 1024] (RGB 0..255, long side 1024, padded with the mean) → `image_embeddings`;
    decoder with points, an unused mask and `orig_im_size` → `masks` [1, M, H, W] logits, `iou_predictions` [1, M].

    Raises:
        ModelUnavailableError: on opening, when a file does not keep this contract.
    """

    def __init__(self, encoder: Path, decoder: Path, *, name: str, threads: int = 0) -> None:
        self._encoder = open_session(encoder, name=name, threads=threads)
        self._decoder = open_session(decoder, name=name, threads=threads)
        features = (1, 256, 64, 64)
        check_contract(
            self._encoder,
            name=name,
            inputs={"image": (1, 3, _SIDE, _SIDE)},
            outputs={"image_embeddings": features},
        )
        check_contract(
            self._decoder,
            name=name,
            inputs={
                "image_embeddings": features,
                "point_coords": (1, None, 2),
                "point_labels": (1, None),
                "mask_input": (1, 1, 256, 256),
                "has_mask_input": (1,),
                "orig_im_size": (2,),
            },
            outputs={"masks": (None, None, None, None), "iou_predictions": (None, None)},
        )

    def embed(self, image: Image) -> _Embedding:
        """Features of uint8 [H, W, 3]."""
        tensor, scale = long_side_padded(image, _SIDE, _MEAN)
        features = self._encoder.run(["image_embeddings"], {"image": tensor})[0]
        return _Embedding(features, scale, image.shape[0], image.shape[1])

    def masks(self, embedding: _Embedding, boxes: NDArray[np.float32]) -> NDArray[np.bool_]:
        """bool [K, H, W] for float32 [K, 4] boxes in pixels of the image."""
        result = np.zeros((len(boxes), embedding.height, embedding.width), np.bool_)
        for row, box in enumerate(boxes):
            feed = {
                "image_embeddings": embedding.features,
                "point_coords": (box.reshape(1, 2, 2) * embedding.scale).astype(np.float32),
                "point_labels": _BOX_CORNERS,
                "mask_input": np.zeros((1, 1, 256, 256), np.float32),
                "has_mask_input": np.zeros(1, np.float32),
                "orig_im_size": np.array([embedding.height, embedding.width], np.float32),
            }
            logits, quality = self._decoder.run(["masks", "iou_predictions"], feed)
            result[row] = logits[0, select_mask(logits[0], quality[0], box)] > 0
        return result
