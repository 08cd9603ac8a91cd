"""A scene that can be asked."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from service.common.camera import PosedCamera
from service.common.errors import InvalidInputError, LimitExceededError, ModelUnavailableError
from service.query.calibration import Thresholds, thresholds_for
from service.query.embeddings import TextCache, embed_labels
from service.query.explain import explain
from service.query.labels import most_probable_class
from service.query.names import candidate_names, check_texts, noun_phrase
from service.query.relevancy import Entries, entries, score
from service.query.settings import QuerySettings
from service.query.types import Answer, Mask2D, Match, Verdict
from service.scene.types import Scene

if TYPE_CHECKING:  # torch and onnxruntime load when they are used
    from service.perception.text import TextEncoder
    from service.query.views import Renderer

_DEFAULTS = QuerySettings()
_NOWHERE = np.inf


class SceneIndex:
    """One scene, one text encoder. Threads may share it; asking touches no renderer.

    An entry is *exact* when the hash table knows the query's name (without question words and articles), or when its
    score reaches the encoder's exact threshold. Otherwise entries from the encoder's related threshold on are
    *related*. An encoder that was never calibrated (and no thresholds in the settings) knows names only; its answers
    say so.

    Args:
        scene: an artefact.
        encoder: embeds queries; the labels are embedded anew if the scene's came from another encoder or other
            templates.
        settings: see `QuerySettings`.

    Raises:
        ModelUnavailableError: the encoder answers with something else than embeddings.
    """

    def __init__(self, scene: Scene, encoder: TextEncoder, settings: QuerySettings = _DEFAULTS) -> None:
        self.scene = scene
        self.settings = settings
        self._encoder = encoder
        self._cache = TextCache(encoder, settings.templates, settings.cached_texts)
        self._entries = self._embed_entries()
        self._thresholds = self._choose_thresholds()
        self._classes = most_probable_class(scene.gaussians.codes, scene.head)
        self._counts: list[int] = np.bincount(self._classes, minlength=len(scene.dictionary) + 1).tolist()
        self._names = [entry.label for entry in scene.dictionary.entries]
        self._renderer: Renderer | None = None
        self._renderer_lock = threading.Lock()

    @property
    def calibrated(self) -> bool:
        """Whether there are thresholds for this encoder, so that `related` can be said at all."""
        return self._thresholds is not None

    @property
    def gaussian_classes(self) -> NDArray[np.int32]:
        """int32 [G]: dictionary id of each Gaussian, 0 = undetected."""
        return self._classes

    def ask(self, texts: Sequence[str]) -> tuple[Answer, ...]:
        """One answer per text, in order; every answer ranks the whole dictionary.

        Raises:
            InvalidInputError: an empty list or text, not a string, control characters.
            LimitExceededError: too many texts, or one too long.
        """
        check_texts(texts, max_texts=self.settings.max_texts, max_chars=self.settings.max_text_chars)
        queries = self._cache.embed([noun_phrase(text) for text in texts])
        return tuple(self._answer(text, query) for text, query in zip(texts, queries, strict=True))

    def mask3d(self, answer: Answer) -> NDArray[np.bool_]:
        """bool [G]: Gaussians whose most probable class is a relevant entry; row number = Gaussian id.

        Raises:
            InvalidInputError: the answer names entries that this scene does not have.
        """
        wanted = np.zeros(len(self._names) + 1, dtype=np.bool_)
        wanted[list(self._relevant_ids(answer))] = True
        return np.asarray(wanted[self._classes])

    def mask2d(self, answer: Answer, posed: PosedCamera) -> Mask2D:
        """Where the answer is in one view; a view of nothing gives an empty mask.

        Raises:
            InvalidInputError: the answer names entries that this scene does not have.
            LimitExceededError: the image is larger than the settings allow.
        """
        relevant = self._relevant_ids(answer)
        relevancy = np.zeros(len(self._names) + 1, dtype=np.float32)
        for match in answer.matches:
            relevancy[match.label_id] = match.relevancy
        return self._renderer_for(posed).mask(posed, relevant, relevancy)

    def render(self, posed: PosedCamera) -> NDArray[np.uint8]:
        """uint8 [H, W, 3]: the scene's colours on black.

        Raises:
            LimitExceededError: the image is larger than the settings allow.
        """
        return self._renderer_for(posed).colours(posed)

    def depth(self, posed: PosedCamera) -> NDArray[np.float32]:
        """float32 [H, W]: expected camera z in scene units, 0 where less than `alpha_min` is covered.

        Raises:
            LimitExceededError: the image is larger than the settings allow.
        """
        return self._renderer_for(posed).depth(posed)

    def label_map(self, posed: PosedCamera) -> NDArray[np.uint16]:
        """uint16 [H, W]: dictionary id of each pixel's most probable class, 0 = undetected or too little covered.

        Raises:
            LimitExceededError: the image is larger than the settings allow.
        """
        return self._renderer_for(posed).label_map(posed)

    def _answer(self, text: str, query: NDArray[np.float32]) -> Answer:
        scores = score(self._entries, query[None], self.settings.temperature)
        similarity, margin, relevancy = scores.similarity[0], scores.margin[0], scores.relevancy[0]
        primary, second = (similarity, margin) if self.settings.score == "similarity" else (margin, similarity)
        named = self._named(text)
        verdict, chosen = self._judge(primary, named)
        order = np.lexsort((np.arange(len(primary)), -second, -primary, ~chosen))
        negatives = self.settings.negatives
        matches = tuple(
            Match(row + 1, self._names[row], r, s, negatives[j], self._counts[row + 1], c)
            for row, r, s, j, c in zip(
                order.tolist(),
                relevancy[order].tolist(),
                similarity[order].tolist(),
                self._entries.nearest_negative[order].tolist(),
                chosen[order].tolist(),
                strict=True,
            )
        )
        return Answer(text, verdict, matches, explain(text, verdict, matches, named is not None, self.calibrated))

    def _named(self, text: str) -> int | None:
        for name in candidate_names(text):
            found = self.scene.dictionary.id_of(name)
            if found is not None:
                return found
        return None

    def _judge(self, scores: NDArray[np.float64], named: int | None) -> tuple[Verdict, NDArray[np.bool_]]:
        """The verdict and the entries it speaks of, bool [N]."""
        if named is not None:
            chosen = np.zeros(len(scores), dtype=np.bool_)
            chosen[named - 1] = True
            return "exact", chosen
        thresholds = self._thresholds or Thresholds(related=_NOWHERE, exact=_NOWHERE)
        exact = scores >= thresholds.exact
        if exact.any():
            return "exact", exact
        related = scores >= thresholds.related
        return ("related" if related.any() else "absent"), related

    def _relevant_ids(self, answer: Answer) -> tuple[int, ...]:
        if any(not 1 <= match.label_id <= len(self._names) for match in answer.matches):
            raise InvalidInputError(
                f"the answer to {answer.text[:80]!r} belongs to another scene",
                field="answer",
                hint="Ask this scene first.",
            )
        return answer.relevant_ids

    def _embed_entries(self) -> Entries:
        negatives = self._cache.embed(self.settings.negatives)
        scene, encoder = self.scene, self._encoder
        same = scene.text_encoder == (encoder.name, encoder.sha256) and scene.label_templates == self.settings.templates
        labels = scene.label_embeddings if same else embed_labels(scene.dictionary, encoder, self.settings.templates)
        if len(labels) and labels.shape[1] != negatives.shape[1]:
            raise ModelUnavailableError(
                f"text encoder {encoder.name} gives {negatives.shape[1]} numbers, not {labels.shape[1]}",
                field="text_encoder",
                hint="Put back the encoder that the scene was made with.",
            )
        return entries(np.ascontiguousarray(labels), negatives)

    def _choose_thresholds(self) -> Thresholds | None:
        chosen = self.settings
        measured = thresholds_for(
            self._encoder.name, self._encoder.sha256, chosen.score, chosen.templates, chosen.negatives
        )
        related = chosen.threshold if chosen.threshold is not None else measured and measured.related
        exact = chosen.exact_threshold if chosen.exact_threshold is not None else measured and measured.exact
        if related is None:
            return None
        return Thresholds(related=related, exact=_NOWHERE if exact is None else exact)

    def _renderer_for(self, posed: PosedCamera) -> Renderer:
        side = self.settings.max_image_side
        if max(posed.camera.width, posed.camera.height) > side:
            raise LimitExceededError(
                f"an image of {posed.camera.width}×{posed.camera.height} pixels",
                field="camera.width/height",
                limit=f"{side} pixels a side (FASTSPLAT_QUERY__MAX_IMAGE_SIDE)",
                hint="Ask for a smaller image and scale the intrinsics with it.",
            )
        with self._renderer_lock:
            if self._renderer is None:
                from service.query.views import Renderer

                self._renderer = Renderer(self.scene, self.settings)
            return self._renderer
