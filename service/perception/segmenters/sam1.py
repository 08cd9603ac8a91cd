"""Segmenters with the original Segment-Anything ONNX contract (SAM, MobileSAM, EdgeSAM exports)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.image_tensors import long_side_padded
from fastsplat.service.perception.onnx_session import check_contract, open_session
from fastsplat.service.perception.results import Image, MaskLogits, Prompts, box_prompts
from fastsplat.service.perception.segmenters.mask_postprocessing import best_answers, select_mask, upsampled
from fastsplat_contract.errors import ModelUnavailableError

_SIDE = 1024
_GRID = 256
_BATCH = 8  # prompts at once: more are no faster, and each takes 20 MB
_MEAN = np.array([123.675, 116.28, 103.53], np.float32)
_BOX_CORNERS = np.array([[2, 3]], np.float32)  # the contract's point labels of a box


@dataclass(frozen=True)
class _Embedding:
    features: NDArray[np.float32]
    scale: float
    height: int
    width: int


class Sam1:
    """Adapter of the original Segment-Anything ONNX contract.

    Encoder `image` [1, 3, 1024, 1024] (RGB 0..255, long side 1024, padded with the mean) → `image_embeddings`; decoder
    with points, an unused mask and `orig_im_size` → `masks` [1, M, H, W] logits, `iou_predictions` [1, M]. An optional
    second decoder takes `image_embeddings`, `point_coords` [B, N, 2] and `point_labels` [B, N] and gives
    `low_res_masks` [B, M, 256, 256] and `iou_predictions` [B, M]; without it, prompts are decoded one by one by the
    first one's `low_res_masks`.

    Raises:
        ModelUnavailableError: a file breaks this contract; on `mask_logits`, both the second decoder and that output
            are missing.
    """

    def __init__(self, encoder: Path, decoder: Path, *, name: str, threads: int = 0, batch: Path | None = None) -> None:
        self._name = name
        self._encoder = open_session(encoder, name=name, threads=threads)
        self._decoder = open_session(decoder, name=name, threads=threads)
        features = (1, 256, 64, 64)
        check_contract(
            self._encoder, name=name, inputs={"image": (1, 3, _SIDE, _SIDE)}, outputs={"image_embeddings": features}
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
        self._batch = None if batch is None else open_session(batch, name=name, threads=threads)
        if self._batch is not None:
            check_contract(
                self._batch,
                name=name,
                inputs={"image_embeddings": features, "point_coords": (None, None, 2), "point_labels": (None, None)},
                outputs={"low_res_masks": (None, None, _GRID, _GRID), "iou_predictions": (None, None)},
            )

    def embed(self, image: Image) -> _Embedding:
        tensor, scale = long_side_padded(image, _SIDE, _MEAN)
        features = self._encoder.run(["image_embeddings"], {"image": tensor})[0]
        return _Embedding(features, scale, image.shape[0], image.shape[1])

    def masks(self, embedding: _Embedding, boxes: NDArray[np.float32]) -> NDArray[np.bool_]:
        """bool [K, H, W] for float32 [K, 4] boxes in pixels of the image."""
        if self._batch is not None:  # at grid resolution; only the best answers are enlarged
            best = best_answers(self.mask_logits(embedding, box_prompts(boxes)), boxes)
            size = (embedding.height, embedding.width)
            return upsampled(best.logits[:, 0], best.scale, size, embedding.width, embedding.height)
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

    def mask_logits(self, embedding: _Embedding, prompts: Prompts) -> MaskLogits:
        scale = embedding.scale * _GRID / _SIDE
        rows, columns = (max(1, math.ceil(side * scale)) for side in (embedding.height, embedding.width))
        points = prompts.points * np.float32(embedding.scale)
        parts = [self._decode(embedding, points[at], prompts.kinds[at]) for at in self._batches(len(prompts))]
        if not parts:
            return MaskLogits(np.zeros((0, 4, rows, columns), np.float32), np.zeros((0, 4), np.float32), (scale, scale))
        logits = np.concatenate([part[0][:, :, :rows, :columns] for part in parts])
        return MaskLogits(logits, np.concatenate([part[1] for part in parts]), (scale, scale))

    def _batches(self, count: int) -> list[slice]:
        size = 1 if self._batch is None else _BATCH
        return [slice(start, start + size) for start in range(0, count, size)]

    def _decode(
        self, embedding: _Embedding, points: NDArray[np.float32], kinds: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        outputs = ["low_res_masks", "iou_predictions"]
        feed = {"image_embeddings": embedding.features, "point_coords": points, "point_labels": kinds}
        if self._batch is not None:
            logits, quality = self._batch.run(outputs, feed)
            return logits, quality
        if "low_res_masks" not in {node.name for node in self._decoder.get_outputs()}:
            raise ModelUnavailableError(
                f"model {self._name}: its decoder has no output low_res_masks, and there is no decoder_batch file",
                field=self._name,
                hint=f'Run "fastsplat models pull {self._name}".',
            )
        feed |= {
            "mask_input": np.zeros((1, 1, _GRID, _GRID), np.float32),
            "has_mask_input": np.zeros(1, np.float32),
            "orig_im_size": np.array([embedding.height, embedding.width], np.float32),
        }
        logits, quality = self._decoder.run(outputs, feed)
        return logits, quality
