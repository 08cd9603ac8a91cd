"""Calibrated probabilities and conformal label sets from scores: pure arithmetic."""

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
"""Leads are clipped to this."""


class Logistic(BaseModel):
    """p = σ(score·x + lead·l + offset): Platt scaling with the lead l, see `leads`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    score: float
    lead: float = 0.0
    offset: float


class Nonconformities(BaseModel):
    """Nonconformity 1 − p of each calibration question's best acceptable answer, by scene.

    Questions with and without an answer are kept apart: a bound for both together may hold for one kind only."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    present: tuple[tuple[float, ...], ...] = ()  # of questions to which an entry answers
    absent: tuple[tuple[float, ...], ...] = ()  # of questions to which nothing here answers

    def bounds(self, coverage: float) -> tuple[float, float]:
        """Nonconformity bounds of "nothing here" and of entries for a coverage."""
        return nonconformity_bound(self.absent, coverage), nonconformity_bound(self.present, coverage)


class ScoreCalibration(BaseModel):
    """The calibration of one encoder and one score.

    Attributes:
        background: usual best score of a dictionary without an answer; an entry leads over this at most.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    related: float  # from here on an entry is worth showing
    exact: float  # from here on it is the object itself
    entry: Logistic  # probability that who asks accepts the entry
    present: Logistic  # probability that anything in the dictionary answers, of its best score
    background: float
    temperature: float  # t by which relevancy σ(t·margin) comes nearest to the probability that an entry is accepted
    scenes: Nonconformities  # nonconformities of the calibration scenes


def leads(scores: F64, background: float, limit: float = LEAD_LIMIT) -> F64:
    """Lead of each entry over the best other and the background, [..., N], clipped."""
    rivals = np.full(scores.shape, background)
    if scores.shape[-1] > 1:
        first = scores.argmax(axis=-1)[..., None]
        rest = scores.copy()
        np.put_along_axis(rest, first, -np.inf, axis=-1)
        np.maximum(rivals, np.take_along_axis(scores, first, axis=-1), out=rivals)
        np.put_along_axis(rivals, first, np.maximum(rest.max(axis=-1, keepdims=True), background), axis=-1)
    return np.asarray(np.clip(scores - rivals, -limit, limit))


def entry_probability(scores: F64, calibration: ScoreCalibration) -> F64:
    """Probability of each entry on its own, [..., N], monotone in the scores."""
    model = calibration.entry
    logits = model.score * scores + model.lead * leads(scores, calibration.background) + model.offset
    return logistic(logits)


def present_probability(scores: F64, entry: F64, calibration: ScoreCalibration) -> F64:
    """Probability [...] that any entry answers; at least the best entry's, 0 without entries."""
    if not scores.shape[-1]:
        return np.zeros(scores.shape[:-1])
    model = calibration.present
    return np.asarray(np.maximum(logistic(model.score * scores.max(axis=-1) + model.offset), entry.max(axis=-1)))


def candidates(entry: F64, present: float) -> F64:
    """Nonconformity of each answer, [N + 1]: 0 is "nothing here", n is entry n."""
    return np.concatenate([[present], 1.0 - entry])


@lru_cache(256)
def nonconformity_bound(scenes: tuple[tuple[float, ...], ...], coverage: float) -> float:
    """Conformal bound of the nonconformity of acceptable answers at a coverage.

    It holds for a question to a scene like the calibration scenes with probability `coverage`; infinite if the scenes
    are too few. Questions to one scene are dependent, scenes are not: each scene has the same mass, shared by its
    questions, and the new scene's mass lies at infinity (hierarchical conformal prediction: Lee, Barber and Willett
    2023, section 3)."""
    if coverage <= 0.0:
        return -np.inf
    values = np.concatenate([np.asarray(scene, dtype=np.float64) for scene in scenes] or [np.zeros(0)])
    masses = np.concatenate([np.full(len(scene), 1.0 / len(scene)) for scene in scenes] or [np.zeros(0)])
    order = values.argsort(kind="stable")
    reached = masses[order].cumsum() / (len(scenes) + 1)
    place = int(np.searchsorted(reached, coverage - 1e-12))
    return float(values[order[place]]) if place < len(values) else np.inf


def label_set(nonconformity: F64, bounds: tuple[float, float]) -> tuple[int, ...]:
    """Answers within their bounds, likeliest first (ties: lower id); never empty.

    With the bounds of a coverage, the set holds an acceptable answer that often if there is one, and "nothing here"
    that often if there is none (class-conditional conformal prediction: Vovk, "Conditional validity of inductive
    conformal predictors", 2012)."""
    order = nonconformity.argsort(kind="stable")
    within = nonconformity <= np.where(np.arange(len(nonconformity)) == 0, *bounds)
    within[order[0]] = True
    return tuple(order[within[order]].tolist())


@dataclass(frozen=True)
class Belief:
    """Probabilities of one answer: calibrated meaning times correctness of names.

    Meaning is calibrated on dictionaries with correct names (benchmarks/calibration); correctness is
    `DictionaryEntry.confidence`, 1 for names from the capture or a person. They are assumed independent, and a wrongly
    named entry counts as no answer. With confidences of 1 all figures are exactly the calibrated ones.

    Attributes:
        label_set: label ids, likeliest first, with the requested coverage given correct names; 0, "nothing here", is
            added if no entry's name is as certain as the coverage.
    """

    entries: F64  # float64 [N], 0..1, for each entry
    presence: float  # 0..1, that anything here answers
    label_set: tuple[int, ...]


def scored_belief(scores: F64, likely: F64, confidence: F64, calibration: ScoreCalibration, coverage: float) -> Belief:
    """Probabilities from scores."""
    present = float(present_probability(scores, likely, calibration))
    return believed(likely, present, confidence, calibration.scenes, coverage)


def believed(likely: F64, present: float, confidence: F64, scenes: Nonconformities, coverage: float) -> Belief:
    """Probabilities if no name decides.

    Args:
        likely: float64 [N], 0..1, that each entry answers, given a correct name.
        present: 0..1, that anything answers, given correct names.
        confidence: float64 [N], 0..1, of correct names.
        scenes: nonconformities of the calibration scenes.
        coverage: 0..1, of the label set.
    """
    labels = label_set(candidates(likely, present), scenes.bounds(coverage))
    entries = likely * confidence
    best = confidence[entries.argmax()] if len(entries) else 1.0
    return Belief(entries, float(present * best), _doubted(labels, confidence, coverage))


def named_belief(likely: F64, label_ids: Sequence[int], confidence: F64, coverage: float) -> Belief:
    """Probabilities if the question is a name of entries, so that scores add nothing."""
    rows = np.array(label_ids) - 1
    certain = likely.copy()
    certain[rows] = 1.0
    entries = certain * confidence
    ordered = tuple(sorted(label_ids, key=lambda label_id: -confidence[label_id - 1]))
    return Belief(entries, float(entries.max()), _doubted(ordered, confidence, coverage))


def _doubted(labels: tuple[int, ...], confidence: F64, coverage: float) -> tuple[int, ...]:
    """Adds 0 to the label set if no entry's name is certain enough."""
    if 0 in labels or confidence[np.array(labels) - 1].max() >= coverage:
        return labels
    return (*labels, 0)
