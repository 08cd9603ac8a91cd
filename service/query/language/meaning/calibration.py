"""The measured calibration of each text encoder; that of one says nothing of another."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from fastsplat.service.query.language.meaning.probability import ScoreCalibration

Score = Literal["similarity", "relevancy"]

FILE = Path(__file__).with_name("calibration.json")
"""Written by benchmarks/calibration."""

_HASH_DIGITS = 12


class Calibration(BaseModel):
    """The calibration of one encoder.

    Attributes:
        templates, negatives: the prompts it was measured with.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    templates: tuple[str, ...]
    negatives: tuple[str, ...]
    date: str  # ISO date
    scores: Mapping[Score, ScoreCalibration]  # by score; `relevancy` counts in the margin d·q − max_j d·c_j
    figures: Mapping[str, Any]  # accuracies, areas and calibration errors on labels and scenes that set nothing


def calibration_key(name: str, sha256: str) -> str:
    """Key of an encoder in the calibration file: its name and the beginning of its weights' hash."""
    return f"{name}@{sha256[:_HASH_DIGITS]}"


def calibration_for(
    name: str, sha256: str, score: Score, templates: Sequence[str], negatives: Sequence[str]
) -> ScoreCalibration | None:
    """The calibration, or None if this encoder was not measured with these prompts (for the similarity the negatives
    do not matter, and their order never does)."""
    calibration = _load().get(calibration_key(name, sha256))
    if calibration is None or calibration.templates != tuple(templates):
        return None
    if score == "relevancy" and set(calibration.negatives) != set(negatives):
        return None
    return calibration.scores.get(score)


@cache
def _load() -> dict[str, Calibration]:
    return {key: Calibration.model_validate(value) for key, value in json.loads(FILE.read_text()).items()}
