"""Scores to probabilities and to label sets with stated coverage: pure arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from fastsplat.service.common.logistic import logistic

F64 = NDArray[np.float64]

LEAD_LIMIT = 0.3
"""Leads are clipped to this; a larger one says no more."""


class Logistic(BaseModel):
    """p = σ(score·x + lead·l + offset), Platt's scaling with the entry's lead l over the best other entry as a second
    feature; see `leads`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    score: float
    lead: float = 0.0
    offset: float


class Nonconformities(BaseModel):
    """1 − the probability of each calibration question's best acceptable answer, by scene, of questions that have one
    and of those that have none apart: what holds for both together may hold for one of them only.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    present: tuple[tuple[float, ...], ...] = ()  # of questions to which an entry answers
    absent: tuple[tuple[float, ...], ...] = ()  # of questions to which nothing here answers

    def bounds(self, coverage: float) -> tuple[float, float]:
        """Up to which nonconformity "nothing here", and up to which an entry, belongs to a set of this coverage."""
        return nonconformity_bound(self.absent, coverage), nonconformity_bound(self.present, coverage)


class ScoreCalibration(BaseModel):
    """The calibration of one encoder and one score.

    Attributes:
        background: the usual best score of a dictionary that has nothing for a text; an entry leads over this at most.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    related: float  # from here on an entry is worth showing
    exact: float  # from here on it is the object itself
    entry: Logistic  # probability that who asks accepts the entry
    present: Logistic  # probability that anything in the dictionary answers, of its best score
    background: float
    temperature: float  # t by which relevancy σ(t·margin) comes nearest to the probability that an entry is accepted
    scenes: Nonconformities  # nonconformities of the calibration scenes


def leads(scores: F64, background: float) -> F64:
    """[..., N] of scores [..., N]: how far each entry is above the best of the others (negative for all but the first)
    and above the background, which stands in where there are no others; clipped to ±`LEAD_LIMIT`."""
    others = np.full(scores.shape, background)
    if scores.shape[-1] > 1:
        first = scores.argmax(axis=-1)[..., None]
        rest = scores.copy()
        np.put_along_axis(rest, first, -np.inf, axis=-1)
        np.maximum(others, np.take_along_axis(scores, first, axis=-1), out=others)
        np.put_along_axis(others, first, np.maximum(rest.max(axis=-1, keepdims=True), background), axis=-1)
    return np.asarray(np.clip(scores - others, -LEAD_LIMIT, LEAD_LIMIT))


def entry_probability(scores: F64, calibration: ScoreCalibration) -> F64:
    """[..., N] of scores [..., N]: each entry on its own; in the order of the scores."""
    model = calibration.entry
    logits = model.score * scores + model.lead * leads(scores, calibration.background) + model.offset
    return logistic(logits)


def present_probability(scores: F64, entry: F64, calibration: ScoreCalibration) -> F64:
    """[...] of scores [..., N] and their `entry_probability`: that anything here answers; 0 without entries. Never
    below the best entry's own probability, of which it is a consequence."""
    if not scores.shape[-1]:
        return np.zeros(scores.shape[:-1])
    model = calibration.present
    return np.asarray(np.maximum(logistic(model.score * scores.max(axis=-1) + model.offset), entry.max(axis=-1)))


def candidates(entry: F64, present: float) -> F64:
    """[N + 1]: the nonconformity of every possible answer, 1 − its probability: 0 is "nothing here", n is entry n."""
    return np.concatenate([[present], 1.0 - entry])


@lru_cache(256)
def nonconformity_bound(scenes: tuple[tuple[float, ...], ...], coverage: float) -> float:
    """The bound b for which a question to a scene like these has an acceptable answer of nonconformity ≤ b with
    probability `coverage` at least; infinity if so much cannot be promised from so few scenes.

    Questions to one scene depend on one another, scenes do not: each scene carries the same mass, shared by its
    questions, and the new scene's own mass lies at infinity (hierarchical conformal prediction: Lee, Barber and
    Willett 2023, section 3).
    """
    if coverage <= 0.0:
        return -np.inf
    values = np.concatenate([np.asarray(scene, dtype=np.float64) for scene in scenes] or [np.zeros(0)])
    masses = np.concatenate([np.full(len(scene), 1.0 / len(scene)) for scene in scenes] or [np.zeros(0)])
    order = values.argsort(kind="stable")
    reached = masses[order].cumsum() / (len(scenes) + 1)
    place = int(np.searchsorted(reached, coverage - 1e-12))
    return float(values[order[place]]) if place < len(values) else np.inf


def label_set(nonconformity: F64, bounds: tuple[float, float]) -> tuple[int, ...]:
    """The answers whose `candidates` value is within their bound, likeliest first (ties: lower id first); the likeliest
    always, because no answer is no answer.

    With the bounds of a coverage it holds an acceptable answer that often of questions that have one, and "nothing
    here" that often of questions that have none (conformal prediction with a bound a class: Vovk, "Conditional validity
    of inductive conformal predictors", 2012).
    """
    order = nonconformity.argsort(kind="stable")
    within = nonconformity <= np.where(np.arange(len(nonconformity)) == 0, *bounds)
    within[order[0]] = True
    return tuple(order[within[order]].tolist())


@dataclass(frozen=True)
class Belief:
    """Probabilities of one answer: that the words of the question mean an entry, times that the entry is named rightly.

    The first factor is calibrated, on dictionaries whose names are right (benchmarks/calibration); the second is the
    entry's `DictionaryEntry.confidence`, 1 for names that came with the capture or from a person. The two are taken for
    independent, and an entry that is named wrongly for no answer. With confidences of 1 every figure is the calibrated
    one, to the bit.

    Attributes:
        label_set: label ids, likeliest first, of which one answers with the coverage asked for, given that the names
            are right: it is calibrated on words. So 0, "nothing here", joins where no entry of the set is named as
            surely as the coverage asks.
    """

    entries: F64  # float64 [N], 0..1, for each entry
    presence: float  # 0..1, that anything here answers
    label_set: tuple[int, ...]

    def of_verdict(self, leading: int | np.intp | None) -> float:
        """0..1: that the entry in row `leading` answers; None: that nothing does."""
        return 1.0 - self.presence if leading is None else float(self.entries[leading])


def scored_belief(scores: F64, likely: F64, confidence: F64, calibration: ScoreCalibration, coverage: float) -> Belief:
    """Probabilities where scores decide."""
    present = float(present_probability(scores, likely, calibration))
    return believed(likely, present, confidence, calibration.scenes, coverage)


def believed(likely: F64, present: float, confidence: F64, scenes: Nonconformities, coverage: float) -> Belief:
    """Probabilities where no name decides.

    Args:
        likely: float64 [N], 0..1, that each entry answers, if it is named rightly.
        present: 0..1, that anything answers, if all are.
        confidence: float64 [N], 0..1, that each entry is named rightly.
        scenes: nonconformities of the calibration scenes.
        coverage: 0..1, of the label set.
    """
    labels = label_set(candidates(likely, present), scenes.bounds(coverage))
    entries = likely * confidence
    best = confidence[entries.argmax()] if len(entries) else 1.0
    return Belief(entries, float(present * best), _doubted(labels, confidence, coverage))


def named_belief(likely: F64, label_ids: Sequence[int], confidence: F64, coverage: float) -> Belief:
    """Probabilities where the question is the very name of entries: no score can add to that."""
    rows = np.array(label_ids) - 1
    certain = likely.copy()
    certain[rows] = 1.0
    entries = certain * confidence
    ordered = tuple(sorted(label_ids, key=lambda label_id: -confidence[label_id - 1]))
    return Belief(entries, float(entries.max()), _doubted(ordered, confidence, coverage))


def _doubted(labels: tuple[int, ...], confidence: F64, coverage: float) -> tuple[int, ...]:
    """The label set with 0, if none of its entries is named surely enough. More labels never cover less."""
    if 0 in labels or confidence[np.array(labels) - 1].max() >= coverage:
        return labels
    return (*labels, 0)
