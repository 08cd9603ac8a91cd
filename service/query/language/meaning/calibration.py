"""Measured calibrations of text encoders, each valid for one encoder only."""

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
    """The calibration of one encoder."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    templates: tuple[str, ...]  # the prompts it was measured with
    negatives: tuple[str, ...]
    date: str  # ISO date
    scores: Mapping[Score, ScoreCalibration]  # by score; `relevancy` counts in the margin d·q − max_j d·c_j
    figures: Mapping[str, Any]  # accuracies, areas and calibration errors on labels and scenes that set nothing


def calibration_key(name: str, sha256: str) -> str:
    """Key of an encoder in the calibration file: name and beginning of its weights' hash."""
    return f"{name}@{sha256[:_HASH_DIGITS]}"


def calibration_for(
    name: str, sha256: str, score: Score, templates: Sequence[str], negatives: Sequence[str]
) -> ScoreCalibration | None:
    """Calibration of an encoder with these prompts; None if not measured.

    Negatives matter for the relevancy only, and their order never does."""
    calibration = _load().get(calibration_key(name, sha256))
    if calibration is None or calibration.templates != tuple(templates):
        return None
    if score == "relevancy" and set(calibration.negatives) != set(negatives):
        return None
    return calibration.scores.get(score)


@cache
def _load() -> dict[str, Calibration]:
    return {key: Calibration.model_validate(value) for key, value in json.loads(FILE.read_text()).items()}
