"""Texts to ranked dictionary entries: no Gaussian is looked at, and nothing is rendered."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.calibration import calibration_for
from fastsplat.service.query.embeddings import TextCache, embed_labels
from fastsplat.service.query.explain import explain
from fastsplat.service.query.names import candidate_names, check_negatives, check_templates, check_texts, noun_phrase
from fastsplat.service.query.probability import (
    ScoreCalibration,
    candidates,
    entry_probability,
    label_set,
    nonconformity_bound,
    present_probability,
)
from fastsplat.service.query.relevancy import LERF_TEMPERATURE, Entries, entries, score
from fastsplat.service.query.settings import QuerySettings
from fastsplat.service.scene.types import Scene
from fastsplat_contract.errors import LimitExceededError, ModelUnavailableError
from fastsplat_contract.queries import Answer, Match, Verdict, check_coverage

if TYPE_CHECKING:  # onnxruntime loads when it is used
    from fastsplat.service.perception.text import TextEncoder

F64 = NDArray[np.float64]
_NOWHERE = np.inf
_KEPT_PROMPTS = 8


@dataclass(frozen=True)
class _Prompted:
    """A dictionary under one choice of negatives and templates."""

    entries: Entries
    negatives: tuple[str, ...]
    measured: ScoreCalibration | None
    related: float | None
    exact: float
    temperature: float


@dataclass(frozen=True)
class _Verdict:
    verdict: Verdict
    chosen: NDArray[np.bool_]
    named: int | None


class Ranker:
    """One dictionary, one text encoder. Threads may share it; arguments as in `SceneIndex`.

    Args:
        scene: an artefact; only its dictionary and its label embeddings are read.
        counts: Gaussians of each dictionary id, 0 first.
        encoder: embeds queries, and labels where the scene's came from another encoder or other templates.
        settings: see `QuerySettings`.

    Raises:
        ModelUnavailableError: the encoder answers with something else than embeddings.
    """

    def __init__(self, scene: Scene, counts: Sequence[int], encoder: TextEncoder, settings: QuerySettings) -> None:
        self._scene = scene
        self._counts = list(counts)
        self._encoder = encoder
        self._settings = settings
        self._cache = TextCache(encoder, settings.templates, settings.cached_texts)
        self._names = [entry.label for entry in scene.dictionary.entries]
        self._prompted: OrderedDict[tuple[tuple[str, ...], tuple[str, ...]], _Prompted] = OrderedDict()
        self._lock = threading.Lock()
        self._usual = self._prepare(settings.negatives, settings.templates, self._embed_labels(settings.templates))

    @property
    def calibrated(self) -> bool:
        """Whether there are thresholds for this encoder, so that `related` can be said at all."""
        return self._usual.related is not None

    def ask(
        self,
        texts: Sequence[str],
        negatives: Sequence[str] | None,
        templates: Sequence[str] | None,
        coverage: float | None,
    ) -> tuple[Answer, ...]:
        """One answer a text, in order, each with the whole dictionary; arguments and errors as `SceneIndex.ask`."""
        chosen = self._settings
        check_texts(texts, max_texts=chosen.max_texts, max_chars=chosen.max_text_chars)
        limits = {"max_prompts": chosen.max_prompts, "max_chars": chosen.max_text_chars}
        if negatives is not None:
            check_negatives(negatives, **limits)
        if templates is not None:
            check_templates(templates, **limits)
        wanted = chosen.coverage if coverage is None else check_coverage(coverage)
        kept = chosen.templates if templates is None else tuple(templates)
        prompted = self._prompts(chosen.negatives if negatives is None else tuple(negatives), kept)
        queries = self._cache.embed([noun_phrase(text) for text in texts], kept)
        scores = score(prompted.entries, queries, prompted.temperature)
        if chosen.score == "similarity":
            primary, second = scores.similarity, scores.margin
        else:
            primary, second = scores.margin, scores.similarity
        return tuple(
            self._answer(
                text, prompted, wanted, primary[row], second[row], scores.similarity[row], scores.relevancy[row]
            )
            for row, text in enumerate(texts)
        )

    def _answer(
        self,
        text: str,
        prompted: _Prompted,
        coverage: float,
        primary: F64,
        second: F64,
        similarity: F64,
        relevancy: F64,
    ) -> Answer:
        measured = prompted.measured
        likely = None if measured is None else entry_probability(primary, measured)
        judged = self._judge(text, prompted, primary, likely)
        order = np.lexsort((np.arange(len(primary)), -second, -primary, ~judged.chosen))
        probability: float | None = None
        present: float | None = None
        labels: tuple[int, ...] = ()
        if measured is not None and likely is not None:
            present = float(present_probability(primary, likely, measured))
            if judged.named is None:
                bound = nonconformity_bound(measured.scenes, coverage)
                labels = label_set(candidates(likely, present), bound)
                probability = float(likely[order[0]]) if judged.verdict != "absent" else 1.0 - present
            else:
                # The dictionary bears that very name: no question is left that a score could answer.
                likely[judged.named - 1], present, probability, labels = 1.0, 1.0, 1.0, (judged.named,)
        rows = order.tolist()
        matches = tuple(
            map(
                Match._make,
                zip(
                    (order + 1).tolist(),
                    [self._names[row] for row in rows],
                    relevancy[order].tolist(),
                    similarity[order].tolist(),
                    [prompted.negatives[j] for j in prompted.entries.nearest_negative[order].tolist()],
                    [self._counts[row + 1] for row in rows],
                    judged.chosen[order].tolist(),
                    [None] * len(rows) if likely is None else likely[order].tolist(),
                    strict=True,
                ),
            )
        )
        held = _held_against(prompted, judged, float(primary[order[0]]) if rows else -_NOWHERE)
        answer = Answer(
            scene_id="",
            text=text,
            verdict=judged.verdict,
            explanation="",
            probability=probability,
            label_set=labels,
            coverage=None if measured is None else coverage,
            decided_by="score" if judged.named is None else "name",
            threshold=held,
            version="",
            gaussians=sum(self._counts),
            match_count=len(matches),
            matches=matches,
            masks=(),
            presence=present,
        )
        return explain(answer, self._settings.score)

    def _judge(self, text: str, prompted: _Prompted, scores: F64, likely: F64 | None) -> _Verdict:
        """The verdict and the entries it speaks of."""
        named = self._named(text)
        if named is not None:
            return _Verdict("exact", np.arange(1, len(scores) + 1) == named, named)
        exact = scores >= prompted.exact
        if exact.any():
            return _Verdict("exact", exact, None)
        related = scores >= (_NOWHERE if prompted.related is None else prompted.related)
        if related.any() and likely is not None:
            related &= (likely >= self._settings.related_probability) | (scores == scores.max())
        return _Verdict("related" if related.any() else "absent", related, None)

    def _named(self, text: str) -> int | None:
        for name in candidate_names(text):
            found = self._scene.dictionary.id_of(name)
            if found is not None:
                return found
        return None

    def _prompts(self, negatives: tuple[str, ...], templates: tuple[str, ...]) -> _Prompted:
        if (negatives, templates) == (self._settings.negatives, self._settings.templates):
            return self._usual
        key = (negatives, templates)
        with self._lock:
            if key in self._prompted:
                self._prompted.move_to_end(key)
                return self._prompted[key]
        if templates == self._settings.templates:
            labels = self._usual.entries.labels
        else:
            self._check_sentences(templates)
            labels = self._embed_labels(templates)
        made = self._prepare(negatives, templates, labels)
        with self._lock:
            self._prompted[key] = made
            while len(self._prompted) > _KEPT_PROMPTS:
                self._prompted.popitem(last=False)
        return made

    def _check_sentences(self, templates: tuple[str, ...]) -> None:
        count, limit = len(self._names) * len(templates), self._settings.max_sentences
        if count > limit:
            raise LimitExceededError(
                f"{len(self._names)} labels in {len(templates)} templates",
                field="templates",
                limit=f"{limit} sentences (FASTSPLAT_QUERY__MAX_SENTENCES)",
                hint="Send fewer templates.",
            )

    def _embed_labels(self, templates: tuple[str, ...]) -> NDArray[np.float32]:
        scene, encoder = self._scene, self._encoder
        same = scene.text_encoder == (encoder.name, encoder.sha256) and scene.label_templates == templates
        return scene.label_embeddings if same else embed_labels(scene.dictionary, encoder, templates)

    def _prepare(
        self, negatives: tuple[str, ...], templates: tuple[str, ...], labels: NDArray[np.float32]
    ) -> _Prompted:
        encoder, chosen = self._encoder, self._settings
        against = self._cache.embed(negatives, templates)
        if len(labels) and labels.shape[1] != against.shape[1]:
            raise ModelUnavailableError(
                f"text encoder {encoder.name} gives {against.shape[1]} numbers, not {labels.shape[1]}",
                field="text_encoder",
                hint="Put back the encoder that the scene was made with.",
            )
        measured = calibration_for(encoder.name, encoder.sha256, chosen.score, templates, negatives)
        related, exact = chosen.threshold, chosen.exact_threshold
        if measured is not None:
            related = measured.related if related is None else related
            exact = measured.exact if exact is None else exact
        temperature = chosen.temperature
        if temperature is None:
            temperature = LERF_TEMPERATURE if measured is None else measured.temperature
        return _Prompted(
            entries(np.ascontiguousarray(labels), against),
            negatives,
            measured,
            related,
            _NOWHERE if exact is None or related is None else exact,
            temperature,
        )


def _held_against(prompted: _Prompted, judged: _Verdict, best: float) -> float | None:
    """The threshold that decided: see `Answer.threshold`."""
    if judged.named is not None or prompted.related is None:
        return None
    return prompted.exact if judged.verdict == "exact" and math.isfinite(best) else prompted.related
