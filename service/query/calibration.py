"""Thresholds that were measured for one encoder, and are worth nothing for another."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

Score = Literal["similarity", "relevancy"]

FILE = Path(__file__).with_name("calibration.json")
"""Written by benchmarks/calibration."""

_HASH_DIGITS = 12


class Thresholds(BaseModel):
    """From `related` on an entry is worth showing, from `exact` on it is the thing itself."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    related: float
    exact: float


class Calibration(BaseModel):
    """What was measured for one encoder.

    Attributes:
        templates, negatives: the prompts it was measured with.
        date: ISO date.
        thresholds: by score; `relevancy` counts in the margin d·q − max_j d·c_j.
        figures: accuracies and areas on the labels that did not set the thresholds.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    templates: tuple[str, ...]
    negatives: tuple[str, ...]
    date: str
    thresholds: Mapping[Score, Thresholds]
    figures: Mapping[str, Any]


def calibration_key(name: str, sha256: str) -> str:
    """Key of an encoder in the calibration file: its name and the beginning of its weights' hash."""
    return f"{name}@{sha256[:_HASH_DIGITS]}"


def thresholds_for(
    name: str, sha256: str, score: Score, templates: Sequence[str], negatives: Sequence[str]
) -> Thresholds | None:
    """The measured thresholds, or None if this encoder was not measured with these prompts (for the similarity the
    negatives do not matter)."""
    found = _load().get(calibration_key(name, sha256))
    if found is None or found.templates != tuple(templates):
        return None
    if score == "relevancy" and set(found.negatives) != set(negatives):
        return None
    return found.thresholds.get(score)


@cache
def _load() -> dict[str, Calibration]:
    return {key: Calibration.model_validate(value) for key, value in json.loads(FILE.read_text()).items()}
