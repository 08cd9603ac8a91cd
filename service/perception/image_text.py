"""Image-text models with a shared embedding space, like CLIP (Radford et al. 2021)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from fastsplat.service.perception.image_tensors import square_around
from fastsplat.service.perception.models.model_files import image_and_text, tokenizer
from fastsplat.service.perception.models.model_manifest import find_model
from fastsplat.service.perception.onnx_session import check_contract, file_sha256, open_session
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Image
from fastsplat.service.perception.text.text_encoders import ClipTextEncoder

F32 = NDArray[np.float32]

_MEAN = np.array([0.48145466, 0.4578275, 0.40821073], np.float32)
_DEVIATION = np.array([0.26862954, 0.26130258, 0.27577711], np.float32)
_SIDE = 224  # side of pictures if the network does not tell


class ClipImageText:
    """An image network and a text tower of one embedding space; also a text encoder.

    `pixel_values` [N, 3, S, S] → `image_embeds` [N, E]; text as in `ClipTextEncoder`. The image network is opened for
    the first picture. Raises `ModelUnavailableError` if a file is missing, damaged, or breaks this contract.
    """

    def __init__(self, image: Path, text: Path, words: Path, *, name: str, threads: int = 0) -> None:
        self._image = image
        self._threads = threads
        self._text = ClipTextEncoder(text, words, name=name, threads=threads)
        self.name = name
        both = file_sha256(image) + self._text.sha256
        self.sha256 = hashlib.sha256(both.encode()).hexdigest()

    def encode(self, texts: Sequence[str]) -> F32:
        """float32 [B, E] of unit length."""
        return self._text.encode(texts)

    def embed(self, image: Image, mask: NDArray[np.bool_]) -> F32:
        """float32 [E] of unit length, of a non-empty mask with a margin."""
        side = self._session.get_inputs()[0].shape[2]
        crop, _ = square_around(image, mask, side if isinstance(side, int) else _SIDE)
        pixels = (crop.astype(np.float32) / 255 - _MEAN) / _DEVIATION
        embedding = self._session.run(["image_embeds"], {"pixel_values": pixels.transpose(2, 0, 1)[None]})[0][0]
        return np.asarray(embedding / np.linalg.norm(embedding), np.float32)

    @cached_property
    def _session(self) -> onnxruntime.InferenceSession:
        session = open_session(self._image, name=self.name, threads=self._threads)
        check_contract(
            session,
            name=self.name,
            inputs={"pixel_values": (None, 3, None, None)},
            outputs={"image_embeds": (None, None)},
        )
        return session


def open_image_text(settings: PerceptionSettings, models: Path) -> ClipImageText:
    """Opens the model of `settings.image_text`; raises `ModelUnavailableError` if that fails."""
    name = settings.image_text
    _, inside = find_model(name, "image_text")
    image, text = image_and_text(models / inside, name=name)
    return ClipImageText(image, text, tokenizer(models / inside, name=name), name=name, threads=settings.threads)


def find_image_text(settings: PerceptionSettings, models: Path) -> ClipImageText | None:
    """Opens the model of `settings.image_text`; None if it is unset."""
    return open_image_text(settings, models) if settings.image_text else None
