"""Image-text models with a shared embedding space: CLIP (Radford et al. 2021), SigLIP (Zhai et al. 2023)."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from fastsplat.service.perception.image_tensors import CLIP, Preprocessing, read_preprocessing, square_around
from fastsplat.service.perception.models.model_files import checked_file, image_and_text, tokenizer
from fastsplat.service.perception.models.model_manifest import find_model
from fastsplat.service.perception.onnx_session import Contract, file_sha256, find_contract, input_side, open_session
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Image
from fastsplat.service.perception.text.text_encoders import ClipTextEncoder
from fastsplat_contract.errors import ModelUnavailableError

F32 = NDArray[np.float32]

_PIXELS = (1, 3, None, None)
_CONTRACTS: Mapping[str, Contract] = {
    "CLIP": ({"pixel_values": _PIXELS}, {"image_embeds": (1, None)}),
    "SigLIP": ({"pixel_values": _PIXELS}, {"pooler_output": (1, None)}),
    "open_clip": ({"image": _PIXELS}, {"embedding": (1, None)}),
}
"""By the names of `ClipTextEncoder`'s, whose text towers belong to them."""
_USUAL = {"CLIP": CLIP, "SigLIP": CLIP.model_copy(update=dict.fromkeys(("mean", "std"), (0.5,) * 3))}
"""Preprocessing without a file that says it; open_clip's models differ."""
_CONFIGS = ("preprocess_cfg.json", "preprocessor_config.json")
_BATCH = 8  # pictures a run, where a network takes several: a fifth less CPU time than one by one


class ClipImageText:
    """An image network and a text tower of one embedding space; also a text encoder.

    The network's names of inputs and outputs tell its contract; text as in `ClipTextEncoder`. Preprocessing is that of
    `preprocess_cfg.json` or `preprocessor_config.json` beside it, else CLIP's or SigLIP's. The image network is opened
    for the first picture. Raises `ModelUnavailableError` if a file is missing, damaged, or breaks this contract.
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

    def embed(self, image: Image, masks: Sequence[NDArray[np.bool_]]) -> F32:
        """float32 [N, E] of unit length, of one or more non-empty masks of an image, with a margin."""
        session, preprocessing = self._network
        (node,) = session.get_inputs()
        (output,) = _CONTRACTS[self._text.contract][1]
        tensors = [preprocessing.tensor(square_around(image, mask)[0]) for mask in masks]
        step = 1 if isinstance(node.shape[0], int) else _BATCH
        rows = []
        for start in range(0, len(tensors), step):
            pixels = np.concatenate(tensors[start : start + step])
            try:
                rows += [*session.run([output], {node.name: pixels})[0]]
            except Exception as error:  # onnxruntime raises many types
                raise self._broken(f"it does not take {list(pixels.shape)}") from error
        embeddings = np.stack(rows)
        return np.asarray(embeddings / np.linalg.norm(embeddings, axis=1, keepdims=True), np.float32)

    @cached_property
    def _network(self) -> tuple[onnxruntime.InferenceSession, Preprocessing]:
        session = open_session(self._image, name=self.name, threads=self._threads)
        contract = find_contract(session, _CONTRACTS, name=self.name)
        if contract != self._text.contract:
            raise self._broken(f"its contract is {contract}'s, that of its network of texts {self._text.contract}'s")
        paths = [checked_file(self._image.with_name(config), name=self.name) for config in _CONFIGS]
        if path := next(filter(Path.is_file, paths), None):
            preprocessing = read_preprocessing(path, name=self.name)
        elif contract in _USUAL:
            side = input_side(session, session.get_inputs()[0].name, _USUAL[contract].size)
            preprocessing = _USUAL[contract].model_copy(update={"size": side})
        else:
            raise self._broken(f"there is no {_CONFIGS[0]} beside it")
        return session, preprocessing

    def _broken(self, what: str) -> ModelUnavailableError:
        hint = f"Put both networks, the tokenizer and {' or '.join(_CONFIGS)} of one model into the folder."
        return ModelUnavailableError(f"model {self.name}, {self._image.name}: {what}", field=self.name, hint=hint)


def open_image_text(settings: PerceptionSettings, models: Path) -> ClipImageText:
    """Opens the model of `settings.image_text`; raises `ModelUnavailableError` if that fails."""
    name = settings.image_text
    _, inside = find_model(name, "image_text")
    image, text = image_and_text(models / inside, name=name)
    return ClipImageText(image, text, tokenizer(text.parent, name=name), name=name, threads=settings.threads)


def find_image_text(settings: PerceptionSettings, models: Path) -> ClipImageText | None:
    """Opens the model of `settings.image_text`; None if it is unset."""
    return open_image_text(settings, models) if settings.image_text else None
