"""Names to unit vectors through prompt templates, with a cache of recent ones."""

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
from fastsplat.service.query.settings import QuerySettings
from fastsplat_contract.errors import ModelUnavailableError

if TYPE_CHECKING:  # a type only: onnxruntime stays out of processes that merely know the settings
    from fastsplat.service.perception.results import TextEncoder

F32 = NDArray[np.float32]
_DEFAULTS = QuerySettings()
_BATCH = 16
"""Sentences that are encoded between two looks whether anybody waits for them."""
_CACHED_DEFINITIONS = 16_384
"""What is said of some 1,600 labels: 25 MB of 384 numbers each."""


def embed_names(names: Sequence[str], encoder: TextEncoder, templates: Sequence[str]) -> F32:
    """float32 [B, E], unit length: the mean over templates of the encoder's embeddings (CLIP's prompt ensembling,
    Radford et al. 2021, section 3.1.4).

    Raises:
        ModelUnavailableError: the encoder answers with other shapes, or numbers that are not finite.
    """
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
    """float32 [N, E]: what a scene stores as `label_embeddings`, with `label_templates` = `templates`."""
    return embed_names([entry.label for entry in dictionary.entries], encoder, templates)


class TextCache:
    """The embeddings of the names embedded most recently, by owner and templates. Threads may share it."""

    def __init__(self, encoder: TextEncoder, templates: Sequence[str], size: int) -> None:
        self._encoder = encoder
        self._templates = tuple(templates)
        self._size = size
        self._owner = ""
        self._recent: OrderedDict[tuple[str, tuple[str, ...], str], F32] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, owner: str) -> TextCache:
        """The same memory, with the embeddings of one owner: how soon an answer comes tells nobody what others have
        asked. Owners share the room, so that one may push out another's."""
        other = copy.copy(self)
        other._owner = owner
        return other

    def embed(self, names: Sequence[str], templates: Sequence[str] | None = None) -> F32:
        """float32 [B, E], unit length; the encoder runs once, for the names that are new. `templates`: in place of the
        cache's own."""
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
    """What the scenes of one encoder share. Threads may share it.

    Attributes:
        definitions: embeds the lexicon's definitions of labels, as they are; a place of their own, so that opening a
            scene displaces no question.
    """

    texts: TextCache  # embeds questions, in the settings' templates
    definitions: TextCache

    def of(self, owner: str) -> TextCaches:
        """The same memory, with the embeddings of one owner, see `TextCache.of`."""
        return TextCaches(self.texts.of(owner), self.definitions.of(owner))


def text_caches(encoder: TextEncoder, settings: QuerySettings) -> TextCaches:
    """Empty ones of an encoder."""
    return TextCaches(
        TextCache(encoder, settings.templates, settings.cached_texts), TextCache(encoder, ("{}",), _CACHED_DEFINITIONS)
    )
