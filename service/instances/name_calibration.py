"""How probable it is that what a detector calls a thing is right: a model, measured on things with true names."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.common.logistic import logistic

F64 = NDArray[np.float64]

FILE = Path(__file__).with_name("name_calibration.json")
"""Written by `benchmarks.calibration.fit_names`, which says how it is measured."""

_CERTAIN = 0.98
"""Evidence beyond counts as this, on both sides."""
_CLEAR = 0.6
"""Less evidence makes no name more probable than `_UNCLEAR_AT_MOST`, however often it was right elsewhere."""
_UNCLEAR_AT_MOST = 0.9


class NameCategory(BaseModel):
    """One name of the detector.

    Attributes:
        offset: what the logit of its probability has beside that of others.
        things: that were called so, most of all names, when it was measured.
        right: how many of them rightly.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    offset: float
    things: int
    right: int


class NameModel(BaseModel):
    """p = 1 / (1 + exp(−(factor · ln(e / (1 − e)) + offset + the category's offset))), e the evidence; where e is below
    0.6, at most 0.9.

    Attributes:
        detector: that called the things so.
        sets: what the things are of.
        categories: by `label_key` of the name; others have an offset of 0.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    detector: str
    sets: tuple[str, ...]
    factor: float
    offset: float
    categories: Mapping[str, NameCategory]

    def probability(self, evidence: F64, names: Sequence[str]) -> F64:
        """float64 [T, N], 0..1, of evidence [T, N] for N names."""
        offsets = [each.offset if (each := self.categories.get(label_key(name))) else 0.0 for name in names]
        probability = logistic(self.factor * evidence_logit(evidence) + self.offset + np.array(offsets, np.float64))
        return np.where(evidence < _CLEAR, np.minimum(probability, _UNCLEAR_AT_MOST), probability)


def evidence_logit(evidence: F64) -> F64:
    """ln(e / (1 − e)) of evidence, 0..1, kept off both ends."""
    inside = np.clip(evidence, 1 - _CERTAIN, _CERTAIN)
    return np.asarray(np.log(inside / (1 - inside)))


def name_evidence(scores: F64) -> F64:
    """float64 [T, N + 1], 0..1: the mean score of each label, times its share of the scores of all labels of the thing:
    what views call by two names, or seldom, is less sure than what they all call by one.

    Args:
        scores: float64 [T, N + 1], see `NameVotes.mean_scores`.
    """
    total = scores.sum(axis=1, keepdims=True)
    return np.asarray(scores * np.divide(scores, total, out=np.zeros_like(scores), where=total > 0))


def name_probability(scores: F64, names: Sequence[str]) -> F64:
    """float64 [T, N + 1], 0..1: how probable each label is right for each thing; 0 where no view says so.

    Args:
        scores: see `name_evidence`; [:, 0] is 0.
        names: of labels 1..N.
    """
    probability = np.zeros_like(scores)
    probability[:, 1:] = name_model().probability(name_evidence(scores)[:, 1:], names)
    return np.where(scores > 0, probability, 0.0)


@cache
def name_model() -> NameModel:
    """The model of the file."""
    return NameModel.model_validate(json.loads(FILE.read_text()))
