"""Embeddings and thresholds of a dictionary for given negatives and templates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cache import LeastRecentlyUsed
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.query.language.meaning.calibration import calibration_for
from fastsplat.service.query.language.meaning.embeddings import TextCache, embed_labels
from fastsplat.service.query.language.meaning.probability import ScoreCalibration
from fastsplat.service.query.language.meaning.relevancy import LERF_TEMPERATURE, Entries, entries
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat_contract.errors import LimitExceededError, ModelUnavailableError

if TYPE_CHECKING:  # onnxruntime loads when it is used
    from fastsplat.service.perception.results import TextEncoder

_CACHED_CONTEXTS = 8


@dataclass(frozen=True)
class SceneLabels:
    """The labels of a scene as a ranking reads them, without per-Gaussian data.

    Attributes:
        embeddings: float32 [M, E], M ≤ N, unit length, of the scene's labels; a copy, so that no scene file stays
            mapped.
        text_encoder, templates: their source: encoder name and digest, and templates.
    """

    dictionary: Dictionary  # N names: the scene's labels, then what is merely suggested, see `ObjectNames`
    embeddings: NDArray[np.float32]
    text_encoder: tuple[str, str]
    templates: tuple[str, ...]


@dataclass(frozen=True)
class PromptContext:
    """Embeddings and thresholds of a dictionary for one choice of prompts."""

    entries: Entries  # the dictionary's embeddings, and their similarity to the negatives
    negatives: tuple[str, ...]  # canonical negatives
    templates: tuple[str, ...]  # prompt templates
    calibration: ScoreCalibration | None  # what was measured for the encoder with these prompts, or None
    related: float | None  # score from which on an entry is related; None: nothing is known, and names alone count
    exact: float  # score from which on an entry is the object itself; infinite where nothing is known
    temperature: float  # t of the relevancy


class PromptContexts:
    """LRU cache of contexts of one scene and encoder; thread-safe.

    Raises:
        ModelUnavailableError: the encoder returns something other than embeddings, or another size.
    """

    def __init__(self, labels: SceneLabels, encoder: TextEncoder, cache: TextCache, settings: QuerySettings) -> None:
        self._labels = labels
        self._encoder = encoder
        self._cache = cache
        self._settings = settings
        self._recent: LeastRecentlyUsed[tuple[tuple[str, ...], ...], PromptContext] = LeastRecentlyUsed(
            _CACHED_CONTEXTS
        )
        self.default = self._prepare(settings.negatives, settings.templates, self._embed_labels(settings.templates))

    @property
    def nbytes(self) -> int:
        """Bytes of a full cache: the same labels in other templates."""
        return (1 + _CACHED_CONTEXTS) * self.default.entries.labels.nbytes

    def get(self, negatives: tuple[str, ...], templates: tuple[str, ...]) -> PromptContext:
        """Context of these prompts; labels are re-embedded for templates not in the cache.

        Raises:
            LimitExceededError: too many labels times templates.
            ModelUnavailableError: as the class.
        """
        if (negatives, templates) == (self.default.negatives, self.default.templates):
            return self.default

        def prepare() -> PromptContext:
            labels = self.default.entries.labels
            if templates != self.default.templates:
                count, limit = len(self._labels.dictionary), self._settings.max_sentences
                if count * len(templates) > limit:
                    raise LimitExceededError(
                        f"{count} labels in {len(templates)} templates",
                        field="templates",
                        limit=f"{limit} sentences",
                        hint="Send fewer templates.",
                    )
                labels = self._embed_labels(templates)
            return self._prepare(negatives, templates, labels)

        return self._recent.get((negatives, templates), lambda: 1, prepare)

    def _embed_labels(self, templates: tuple[str, ...]) -> NDArray[np.float32]:
        labels, encoder = self._labels, self._encoder
        known = labels.embeddings
        if labels.text_encoder != (encoder.name, encoder.sha256) or labels.templates != templates:
            return embed_labels(labels.dictionary, encoder, templates)
        lacking = [entry.label for entry in labels.dictionary.entries[len(known) :]]
        if not lacking:
            return known
        more = self._cache.embed(lacking, templates)
        return np.concatenate([known, more]) if len(known) else more

    def _prepare(
        self, negatives: tuple[str, ...], templates: tuple[str, ...], labels: NDArray[np.float32]
    ) -> PromptContext:
        encoder, settings = self._encoder, self._settings
        embedded = self._cache.embed(negatives, templates)
        if len(labels) and labels.shape[1] != embedded.shape[1]:
            raise ModelUnavailableError(
                f"text encoder {encoder.name} gives {embedded.shape[1]} numbers, not {labels.shape[1]}",
                field="text_encoder",
                hint="Put back the encoder that the scene was made with.",
            )
        calibration = calibration_for(encoder.name, encoder.sha256, settings.score, templates, negatives)
        related, exact = settings.threshold, settings.exact_threshold
        if calibration is not None:
            related = calibration.related if related is None else related
            exact = calibration.exact if exact is None else exact
        temperature = settings.temperature
        if temperature is None:
            temperature = LERF_TEMPERATURE if calibration is None else calibration.temperature
        return PromptContext(
            entries=entries(np.ascontiguousarray(labels), embedded),
            negatives=negatives,
            templates=templates,
            calibration=calibration,
            related=related,
            exact=math.inf if exact is None or related is None else exact,
            temperature=temperature,
        )
