"""Appearance descriptors of objects, for recognition in other scenes.

They are inner features of the closed-set detector, averaged inside the object's mask and projected onto the directions
that tell kinds of objects apart (compared in docs/naming.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.detectors.open_detectors import CLOSED_SET_DETECTORS
from fastsplat.service.perception.image_tensors import imagenet_tensor, square_around
from fastsplat.service.perception.models.model_files import only_network
from fastsplat.service.perception.models.model_manifest import find_model
from fastsplat.service.perception.onnx_session import open_session
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Image

F32 = NDArray[np.float32]

_SIDE = 416
_LAYERS = ("conv2d_110.tmp_0", "conv2d_117.tmp_0", "conv2d_130.tmp_0")
"""PicoDet-S: the backbone at strides 16 and 32, the neck at stride 32."""
_CHANNELS = (192, 384, 96)
_PICTURE_SIDE = 96
_PICTURE_QUALITY = 80

SIZE = 48
"""Length of a descriptor."""
PROJECTION_FILE = Path(__file__).with_name("appearance_projection.npy")


class AppearanceEncoder:
    """Features of a detector.

    Raises:
        ModelUnavailableError: on opening, a file that is missing, damaged or no such network.
    """

    def __init__(self, model: Path, *, name: str, threads: int = 0) -> None:
        self._session = open_session(model, name=name, threads=threads, inner=_LAYERS)

    def features(self, image: Image, mask: NDArray[np.bool_]) -> F32:
        """Computes features, float32 [sum of `_CHANNELS`], of the image inside a mask, which must not be empty."""
        crop, inside = square_around(image, mask, _SIDE)
        feed = {"image": imagenet_tensor(crop, _SIDE, cubic=False), "scale_factor": np.ones((1, 2), np.float32)}
        return np.concatenate([_pooled(layer[0], inside) for layer in self._session.run(list(_LAYERS), feed)])


def open_appearance_encoder(settings: PerceptionSettings, models: Path) -> AppearanceEncoder | None:
    """Opens the encoder of `settings.closed_set_detector`; None if its layers are not known.

    Raises:
        ModelUnavailableError: unknown name or adapter, missing or damaged file.
    """
    name = settings.closed_set_detector
    adapter, inside = find_model(name, "closed_set_detector")
    if adapter != "picodet" or adapter not in CLOSED_SET_DETECTORS:
        return None
    return AppearanceEncoder(only_network(models / inside, name=name), name=name, threads=settings.threads)


def descriptor_of(features: Sequence[F32]) -> NDArray[np.float16]:
    """Combines the features of an object's pictures into a unit vector, float16 [SIZE]."""
    center, directions = _projection()
    return np.asarray(_unit(pooled_features(features, center) @ directions.T), np.float16)


def pooled_features(features: Sequence[F32], center: NDArray[np.float64]) -> NDArray[np.float64]:
    """Combines the features of an object's pictures, not yet projected, into a unit vector as long as `center`.

    Each layer's features are centered, normalized, averaged over the pictures, and normalized again.
    """
    parts = np.split(np.stack(features).astype(np.float64) - center, np.cumsum(_CHANNELS)[:-1], axis=1)
    return np.asarray(np.concatenate([_unit(_unit(part).mean(axis=0)) for part in parts]) / np.sqrt(len(parts)))


def small_picture(image: Image, mask: NDArray[np.bool_]) -> bytes:
    """Encodes a mask's contents with a margin as a small JPEG for people."""
    crop, _ = square_around(image, mask, _PICTURE_SIDE)
    coded = cv2.imencode(".jpg", cv2.cvtColor(crop, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _PICTURE_QUALITY])
    return coded[1].tobytes()


@cache
def _projection() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean features of objects, and the directions [SIZE, C], of `benchmarks.calibration.fit_appearance`."""
    rows = np.load(PROJECTION_FILE).astype(np.float64)
    return rows[0], rows[1:]


def _unit(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=-1, keepdims=True), 1e-9))


def _pooled(layer: F32, inside: NDArray[np.bool_]) -> F32:
    """Averages [C, h, w] over the cells inside a mask, or those it covers most."""
    share = cv2.resize(inside.astype(np.float32), layer.shape[:0:-1], interpolation=cv2.INTER_AREA)
    weights = np.where(share > min(0.5, 0.9 * float(share.max())), share, 0)
    return np.asarray((layer * weights).sum(axis=(1, 2)) / max(float(weights.sum()), 1e-6), np.float32)
