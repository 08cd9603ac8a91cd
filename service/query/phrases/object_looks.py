"""Probabilities that objects are what a text says, by their looks, from an image-text model.

A text's probability is its share of a softmax over it, the common objects and the scene's names (zero-shot
classification: Radford et al. 2021, section 3.1), at the temperature and with the logistic model that
`looks_calibration` fitted."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.common.logistic import logistic
from fastsplat.service.query.language.meaning.common_objects import all_common_objects, common_objects
from fastsplat.service.query.language.meaning.probability import Logistic
from fastsplat.service.scene.artefact.scene import Object

if TYPE_CHECKING:  # onnxruntime loads when it is used
    from fastsplat.service.perception.results import TextEncoder

F64 = NDArray[np.float64]

_LEAST = 1e-6
"""Shares and probabilities are clipped to this and its complement, so that looks make nothing certain."""
_SURE = 3.0
"""Standard errors above chance from which a model knows objects."""


class HeldOut(BaseModel):
    """Counts on rooms of kinds that set nothing.

    Attributes:
        matched, labels: labels of a room whose objects are nearest to them among the room's labels, of how many; by
            chance one a room.
        right: objects whose likeliest name is right.
        given, given_right, expected: names from `NAMED_FROM`, those right, and the sum of their probabilities.
        denied, present: words of objects that are there, of these said to be absent.
        refused, absent: words of objects of other rooms, of these said to be absent.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    rooms: int
    objects: int
    matched: int
    labels: int
    right: int
    given: int
    given_right: int
    expected: float
    denied: int
    present: int
    refused: int
    absent: int


class Calibration(BaseModel):
    """What the scores of one image-text model mean."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    model: str
    sha256: str  # of the model
    common_objects: str  # SHA-256 of the list of common objects
    temperature: float
    name: Logistic  # probability that a common object's name is true of an object, of the logit of its share
    text: Logistic  # the same of a question
    present: Logistic  # probability that a question is true of any object of a scene, of the likeliest one's logit
    held_out: HeldOut

    @property
    def measured(self) -> bool:
        """True if the model knows objects of rooms better than by chance, so that its figures mean something."""
        rooms, labels = self.held_out.rooms, self.held_out.labels
        return self.held_out.matched - rooms > _SURE * math.sqrt(rooms * (1 - rooms / labels))

    @property
    def summary(self) -> str:
        """One sentence for people."""
        counts = self.held_out
        if not self.measured:
            found = f"{counts.matched} of {counts.labels} labels of drawn rooms, {counts.rooms} by chance"
            return f"{self.model} is not calibrated: it matches {found}; it suggests names, and answers nothing"
        return (
            f"{self.model}, in {counts.rooms} drawn rooms that set nothing: {counts.right} of {counts.objects} objects "
            f"called right; of names given {counts.given_right} of {counts.given} right, {counts.expected:.0f} "
            f'expected; "not here" said of {counts.refused} of {counts.absent} words of what is not there, and of '
            f"{counts.denied} of {counts.present} of what is"
        )


def prompt(text: str) -> str:
    """The caption of a picture of what a text names."""
    return f"a photo of a {text}"


def is_true_of(text: str, label: str) -> bool:
    """True if an object that is `label` may rightly be called `text`: by a synonym, or a kind that the list knows."""
    objects, whole = common_objects(label)
    key = label_key(text)
    return key == label_key(label) or (whole and any(key in obj.names or key in obj.kinds for obj in objects))


def softmax_weights(cosines: F64, peak: F64, temperature: float) -> F64:
    """exp((c - peak) / temperature) of cosines [K, N]; peak [K] is no less than any."""
    return np.asarray(np.exp((cosines - peak[:, None]) / temperature))


def text_share(text: str, weights: F64, total: F64, of_text: F64, names: Sequence[str] = ()) -> F64:
    """Share [K] that a text has of K objects' softmax; its synonyms leave it, and its kinds count as it.

    Args:
        weights: float64 [K, V + S], see `softmax_weights`, of the common objects and S further names.
        total: float64 [K], their sums.
        of_text: float64 [K], of the text.
    """
    key, count = label_key(text), weights.shape[1] - len(names)
    synonyms, kinds = _common_rows(key)
    synonyms = [*synonyms, *(count + at for at, name in enumerate(names) if label_key(name) == key)]
    kinds = [*kinds, *(count + at for at, name in enumerate(names) if label_key(name) != key and is_true_of(key, name))]
    rest = np.maximum(total - weights[:, [*synonyms, *kinds]].sum(axis=1), 0.0)
    mass = of_text + weights[:, kinds].sum(axis=1)
    return np.asarray(mass / (mass + rest))


@lru_cache(1024)
def _common_rows(key: str) -> tuple[Sequence[int], Sequence[int]]:
    """Common objects that a key is a name of, and those that it is a kind of."""
    rows = list(enumerate(all_common_objects()))
    synonyms = [at for at, obj in rows if key in obj.names]
    return synonyms, [at for at, obj in rows if key in obj.kinds and key not in obj.names]


def logit(share: F64) -> F64:
    """ln(p / (1 - p)) of shares, clipped away from 0 and 1."""
    inside = np.clip(share, _LEAST, 1 - _LEAST)
    return np.asarray(np.log(inside / (1 - inside)))


def log_odds(model: Logistic, value: F64) -> F64:
    """Calibrated log odds of a logit."""
    return np.add(model.score * value, model.offset, dtype=np.float64)


@dataclass(frozen=True)
class LooksModel:
    """An image-text model with what its scores mean.

    Attributes:
        encoder: its network of texts.
        common: float16 [V, E] of unit length, embeddings of the common objects' captions.
    """

    encoder: TextEncoder
    calibration: Calibration
    common: NDArray[np.float16] = field(repr=False)

    def embed_text(self, text: str) -> F64:
        """float64 [E] of unit length."""
        return np.asarray(self.encoder.encode([prompt(text)])[0], np.float64)

    def cosines(self, objects: Sequence[Object], names: Sequence[str]) -> F64:
        """float64 [K, V + S], of objects that it looked at with the common objects and S names."""
        texts = [self.common.astype(np.float64), *(self.embed_text(name)[None] for name in names)]
        return np.asarray(embeddings_of(objects) @ np.concatenate(texts).T)


def seen_by(model: LooksModel, objects: Sequence[Object]) -> list[Object]:
    """Objects with an embedding by this very model."""
    return [obj for obj in objects if obj.looks is not None and obj.looks.sha256 == model.encoder.sha256]


def embeddings_of(objects: Sequence[Object]) -> F64:
    """Embeddings of objects with looks, float64 [K, E]."""
    rows = [np.frombuffer(obj.looks.embedding, np.float16) for obj in objects if obj.looks]
    return np.asarray(np.stack(rows), np.float64)


@dataclass(frozen=True)
class ObjectLooks:
    """Looks of one scene's objects; thread-safe. False where no calibrated model looked at any."""

    objects: tuple[Object, ...] = field(repr=False)  # of the scene
    model: LooksModel | None  # compares; None: nothing does

    def __bool__(self) -> bool:
        return bool(self._seen)

    @cached_property
    def _seen(self) -> list[Object]:
        measured = self.model is not None and self.model.calibration.measured
        return seen_by(self.model, self.objects) if self.model is not None and measured else []

    @cached_property
    def ids(self) -> frozenset[int]:
        """Ids of the objects that it looked at."""
        return frozenset(obj.id for obj in self._seen)

    @cached_property
    def _cosines(self) -> tuple[tuple[str, ...], F64]:
        """Names of the scene that no common object has, and cosines [K, V + S] of the objects with all of them."""
        assert self.model is not None
        names = tuple(sorted({obj.name for obj in self.objects if obj.name and not common_objects(obj.name)[1]}))
        return names, self.model.cosines(self._seen, names)

    @cached_property
    def _of_text(self) -> Callable[[str], F64]:
        """Cosines [K] of a text, kept as an answer and its absence ask for the same."""
        assert self.model is not None
        seen, model = embeddings_of(self._seen), self.model
        return lru_cache(16)(lambda text: seen @ model.embed_text(text))

    def likely(self, text: str, before: Mapping[int, float]) -> Mapping[int, float]:
        """Posterior probability, 0..1, that a noun phrase is true of each object with looks.

        `before` has the probabilities by their names, where a nameless object has 1 / (1 + number of objects). Raises
        ModelUnavailableError if the text network embeds in another size."""
        if self.model is None or not self:
            return {}
        names, cosines = self._cosines
        of_text = self._of_text(text)
        peak, temperature = np.maximum(cosines.max(axis=1), of_text), self.model.calibration.temperature
        weights = softmax_weights(np.column_stack([of_text, cosines]), peak, temperature)
        shares = text_share(text, weights[:, 1:], weights[:, 1:].sum(axis=1), weights[:, 0], names)
        named = logit(np.array([before[obj.id] for obj in self._seen])) + np.log(len(before))  # 0 for nameless objects
        together = logistic(log_odds(self.model.calibration.text, logit(shares)) + named)
        return {obj.id: sure for obj, sure in zip(self._seen, together.tolist(), strict=True)}

    def presence(self, text: str, before: Mapping[int, float]) -> float:
        """Probability, 0..1, that a text is true of any object; arguments as `likely`."""
        assert self.model is not None
        most = max(self.likely(text, before).values())
        return float(logistic(log_odds(self.model.calibration.present, logit(np.array(most)))))
