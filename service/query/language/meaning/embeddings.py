"""Embeddings of names through prompt templates, with an LRU cache."""

from __future__ import annotations

import copy
import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat_contract.errors import ModelUnavailableError

if TYPE_CHECKING:  # a type only: onnxruntime stays out of processes that merely know the settings
    from fastsplat.service.perception.results import TextEncoder

F32 = NDArray[np.float32]
_DEFAULTS = QuerySettings()
_BATCH = 16
"""Sentences per encoder call, between checks for cancellation."""
_CACHED_DEFINITIONS = 16_384
"""Definitions of some 1,600 labels: 25 MB at 384 numbers each."""


def embed_names(names: Sequence[str], encoder: TextEncoder, templates: Sequence[str]) -> F32:
    """Embeds names as the mean over templates, float32 [B, E], unit length.

    CLIP's prompt ensembling (Radford et al. 2021, section 3.1.4). Wrong shapes and non-finite values raise
    ModelUnavailableError."""
    if not names:
        return np.zeros((0, 0), dtype=np.float32)
    sentences = [template.replace("{}", name) for name in names for template in templates]
    pieces = []
    for start in range(0, len(sentences), _BATCH):
        check_cancelled()
        pieces.append(np.asarray(encoder.encode(sentences[start : start + _BATCH]), dtype=np.float64))
    vectors = np.concatenate(pieces)
    if vectors.ndim != 2 or len(vectors) != len(sentences) or not np.isfinite(vectors).all():
        raise ModelUnavailableError(
            f"text encoder {encoder.name} answered {len(sentences)} texts with shape {vectors.shape}",
            field="text_encoder",
            hint="Check the model files with `fastsplat models list`.",
        )
    mean = vectors.reshape(len(names), len(templates), -1).mean(axis=1)
    length = np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), np.finfo(np.float32).tiny)
    return np.asarray(mean / length, dtype=np.float32)


def embed_labels(dictionary: Dictionary, encoder: TextEncoder, templates: Sequence[str] = _DEFAULTS.templates) -> F32:
    """Embeds labels as a scene stores them, float32 [N, E] (`label_embeddings`)."""
    return embed_names([entry.label for entry in dictionary.entries], encoder, templates)


class TextCache:
    """LRU cache of name embeddings by owner and templates; thread-safe."""

    def __init__(self, encoder: TextEncoder, templates: Sequence[str], size: int) -> None:
        self._encoder = encoder
        self._templates = tuple(templates)
        self._size = size
        self._owner = ""
        self._recent: OrderedDict[tuple[str, tuple[str, ...], str], F32] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, owner: str) -> TextCache:
        """Returns one owner's view, so that response times leak no queries; capacity is shared."""
        view = copy.copy(self)
        view._owner = owner
        return view

    def embed(self, names: Sequence[str], templates: Sequence[str] | None = None) -> F32:
        """Embeds names in `templates` (or the cache's own), [B, E], unit length, encoding only new ones."""
        used = self._templates if templates is None else tuple(templates)
        keys = {name: (self._owner, used, name) for name in names}
        embeddings: dict[str, F32] = {}
        with self._lock:
            for name, key in keys.items():
                if key in self._recent:
                    self._recent.move_to_end(key)
                    embeddings[name] = self._recent[key]
        new = [name for name in keys if name not in embeddings]
        if new:
            rows = embed_names(new, self._encoder, used)
            embeddings |= {name: row.copy() for name, row in zip(new, rows, strict=True)}  # a view would keep all rows
            with self._lock:
                for name in new:
                    self._recent[keys[name]] = embeddings[name]
                while len(self._recent) > self._size:
                    self._recent.popitem(last=False)
        return np.stack([embeddings[name] for name in names])


@dataclass(frozen=True)
class TextCaches:
    """Caches shared by the scenes of one encoder; thread-safe."""

    texts: TextCache  # embeds questions, in the settings' templates
    definitions: TextCache  # of labels, without templates; separate, so that opening a scene evicts no queries

    def of(self, owner: str) -> TextCaches:
        """Returns views of the caches for one owner, see `TextCache.of`."""
        return TextCaches(self.texts.of(owner), self.definitions.of(owner))


def text_caches(encoder: TextEncoder, settings: QuerySettings) -> TextCaches:
    """Creates empty caches of an encoder."""
    return TextCaches(
        TextCache(encoder, settings.templates, settings.cached_texts), TextCache(encoder, ("{}",), _CACHED_DEFINITIONS)
    )
