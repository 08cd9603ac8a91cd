"""PicoDet exported by Paddle with non-maximum suppression: closed set of COCO-80."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fastsplat.service.perception.box_ops import clip_boxes
from fastsplat.service.perception.class_names import COCO_80
from fastsplat.service.perception.image_tensors import imagenet_tensor
from fastsplat.service.perception.onnx_session import check_contract, input_side, open_session
from fastsplat.service.perception.results import Detections, Image


class PicoDet:
    """Adapter of PicoDet's ONNX export.

    `image` [1, 3, S, S] and `scale_factor` [1, 2] → [K, 6]: class, score, x1, y1, x2, y2 in image pixels. Opening
    raises `ModelUnavailableError` if the file breaks this contract.
    """

    labels = COCO_80

    def __init__(self, model: Path, *, name: str, threads: int = 0) -> None:
        self._session = open_session(model, name=name, threads=threads)
        check_contract(
            self._session, name=name, inputs={"image": (1, 3, None, None), "scale_factor": (1, 2)}, outputs=[(None, 6)]
        )
        self._side = input_side(self._session, "image", 416)

    def detect(self, image: Image, min_score: float) -> Detections:
        """Detects COCO objects that score at least `min_score` (the model itself cuts at about 0.3)."""
        height, width = image.shape[:2]
        feed = {
            "image": imagenet_tensor(image, self._side, cubic=True),
            "scale_factor": np.array([[self._side / height, self._side / width]], np.float32),
        }
        rows = self._session.run(None, feed)[0]
        # Class -1 pads the fixed number of rows.
        rows = rows[(rows[:, 0] >= 0) & (rows[:, 1] >= min_score)]
        return Detections(
            clip_boxes(rows[:, 2:6], width, height),
            rows[:, 1].astype(np.float32),
            tuple(COCO_80[int(row)] for row in rows[:, 0]),
        )
