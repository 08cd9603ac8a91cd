"""Calibrated probability of detected names, measured on things with true names."""

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
"""Written by `benchmarks.calibration.fit_names`, which documents the measurement."""

_CERTAIN = 0.98  # evidence is clipped to this and its complement
_CLEAR = 0.6  # below this evidence, probability is at most `_UNCLEAR_AT_MOST`
_UNCLEAR_AT_MOST = 0.9


class NameCategory(BaseModel):
    """A name of the detector."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    offset: float  # of the logit, relative to other names
    things: int  # measured things with this as their best name
    right: int  # of these, correctly named


class NameModel(BaseModel):
    """Logistic model of p from evidence e, limited to 0.9 if e < 0.6.

    p = 1 / (1 + exp(−(factor · ln(e / (1 − e)) + offset + the category's offset)))
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    detector: str
    sets: tuple[str, ...]  # sources of the measured things
    factor: float
    offset: float
    categories: Mapping[str, NameCategory]  # by `label_key` of the name; others have an offset of 0

    def probability(self, evidence: F64, names: Sequence[str]) -> F64:
        """float64 [T, N], 0..1, of evidence [T, N] for N names."""
        offsets = [each.offset if (each := self.categories.get(label_key(name))) else 0.0 for name in names]
        probability = logistic(self.factor * evidence_logit(evidence) + self.offset + np.array(offsets, np.float64))
        return np.where(evidence < _CLEAR, np.minimum(probability, _UNCLEAR_AT_MOST), probability)


def evidence_logit(evidence: F64) -> F64:
    """Returns ln(e / (1 − e)) of evidence, clipped away from 0 and 1."""
    inside = np.clip(evidence, 1 - _CERTAIN, _CERTAIN)
    return np.asarray(np.log(inside / (1 - inside)))


def name_evidence(scores: F64) -> F64:
    """Evidence of labels, [T, N + 1], 0..1, from `NameVotes.mean_scores`.

    A mean score times its share of the thing's scores: names that are rare among views, or contested, get less.
    """
    total = scores.sum(axis=1, keepdims=True)
    return np.asarray(scores * np.divide(scores, total, out=np.zeros_like(scores), where=total > 0))


def name_probability(scores: F64, names: Sequence[str]) -> F64:
    """Calibrated probability of labels, float64 [T, N + 1], 0..1; 0 without votes.

    Args:
        scores: see `name_evidence`; [:, 0] is 0.
        names: of labels 1..N.
    """
    probability = np.zeros_like(scores)
    probability[:, 1:] = name_model().probability(name_evidence(scores)[:, 1:], names)
    return np.where(scores > 0, probability, 0.0)


@cache
def name_model() -> NameModel:
    """Loads the model from `FILE`."""
    return NameModel.model_validate(json.loads(FILE.read_text()))
