"""How probable it is that what a detector calls a thing is right: a curve, measured on things with true names."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

F64 = NDArray[np.float64]

FILE = Path(__file__).with_name("name_calibration.json")
"""Written by `benchmarks.calibration.fit_names`, which says what the curve is and how it was measured."""


class NameCurve(BaseModel):
    """Probabilities by evidence, and what they were measured on.

    Attributes:
        date: ISO date.
        detector: that called the things so.
        sets: what the things are of.
        evidence: ascending, 0..1; the curve is straight between them, and flat beyond.
        probability: at each of them, 0..1, ascending.
        things: how many things had about that evidence; the first row is of those up to the second value.
        right: how many of them were called right.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    date: str
    detector: str
    sets: tuple[str, ...]
    evidence: tuple[float, ...]
    probability: tuple[float, ...]
    things: tuple[int, ...]
    right: tuple[int, ...]


def name_evidence(scores: F64) -> F64:
    """float64 [T, N + 1], 0..1: the mean score of each label, times its share of the scores of all labels of the thing:
    what views call by two names, or seldom, is less sure than what they all call by one.

    Args:
        scores: float64 [T, N + 1], see `NameVotes.mean_scores`.
    """
    total = scores.sum(axis=1, keepdims=True)
    return np.asarray(scores * np.divide(scores, total, out=np.zeros_like(scores), where=total > 0))


def name_probability(scores: F64) -> F64:
    """float64 [T, N + 1], 0..1: how probable each label is right for each thing; 0 where no view says so.

    Args:
        scores: see `name_evidence`.
    """
    curve = name_curve()
    return np.where(scores > 0, np.interp(name_evidence(scores), curve.evidence, curve.probability), 0.0)


@cache
def name_curve() -> NameCurve:
    """The curve of the file."""
    return NameCurve.model_validate(json.loads(FILE.read_text()))
