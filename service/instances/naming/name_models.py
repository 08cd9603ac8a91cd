"""What a detector's scores mean: probabilities of its names, as measured on known objects."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.common.logistic import logistic
from fastsplat.service.perception.models.model_files import installed_digests
from fastsplat.service.perception.models.model_manifest import find_model
from fastsplat_contract.errors import ModelUnavailableError

F64 = NDArray[np.float64]

FILE = Path(__file__).with_name("name_calibration.json")
"""The default detector's, written by `benchmarks.calibration.fit_names`, which documents the measurement."""
STORED = "calibration.json"
"""File in another detector's folder, beside the pull's receipt."""

_CERTAIN = 0.98  # evidence is clipped to this and its complement
_CLEAR = 0.6  # below this evidence, probability is at most `_UNCLEAR_AT_MOST`
_UNCLEAR_AT_MOST = 0.9
_SURE = 3.0  # standard errors above chance from which a detector knows objects


class NameCategory(BaseModel):
    """A name of the detector."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    offset: float  # of the logit, relative to other names
    objects: int  # measured objects with this as their best name
    right: int  # of these, correctly named


class HeldOutNames(BaseModel):
    """Counts on rooms of kinds that set nothing.

    Attributes:
        objects, called, right: that photos show, of these with any name, and with a right one.
        chance: those expected right if the names were dealt at random.
        given, given_right, expected: names from `NAMED_FROM`, those right, and the sum of their probabilities.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    objects: int
    called: int
    right: int
    chance: float
    given: int
    given_right: int
    expected: float


class NameModel(BaseModel):
    """Logistic model of p from evidence e, limited to 0.9 if e < 0.6.

    p = 1 / (1 + exp(−(factor · ln(e / (1 − e)) + offset + the category's offset)))
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    detector: str
    sha256: Mapping[str, str] = {}  # by file, of the detector
    sets: tuple[str, ...]  # sources of the measured objects
    factor: float
    offset: float
    categories: Mapping[str, NameCategory]  # by `label_key` of the name; others have an offset of 0
    held_out: HeldOutNames | None = None

    def probability(self, evidence: F64, names: Sequence[str]) -> F64:
        """float64 [T, N], 0..1, of evidence [T, N] for N names."""
        offsets = [category.offset if (category := self.categories.get(label_key(name))) else 0.0 for name in names]
        probability = logistic(self.factor * evidence_logit(evidence) + self.offset + np.array(offsets, np.float64))
        return np.where(evidence < _CLEAR, np.minimum(probability, _UNCLEAR_AT_MOST), probability)

    @property
    def measured(self) -> bool:
        """True if the detector calls objects right more often than by chance, so that its figures mean something."""
        counts = self.held_out
        if counts is None:
            return True
        error = math.sqrt(counts.chance * (1 - counts.chance / max(counts.called, 1)))
        return counts.called > 0 and counts.right - counts.chance > _SURE * error

    @property
    def found_share(self) -> float | None:
        """Share of the objects that photos show that are called right, 0..1; None: counted by name for the default."""
        counts = self.held_out
        return None if counts is None else counts.right / counts.objects if self.measured else 0.0

    @property
    def summary(self) -> str:
        """One sentence for people."""
        counts = self.held_out
        assert counts is not None
        called = f"{counts.right} of {counts.objects} objects of drawn rooms called right"
        if not self.measured:
            return f"{self.detector} is not calibrated: {called}, {counts.chance:.0f} by chance; it suggests names only"
        return (
            f"{self.detector}, in rooms that set nothing: {called}; of names given {counts.given_right} of "
            f"{counts.given} right, {counts.expected:.0f} expected"
        )


def evidence_logit(evidence: F64) -> F64:
    """Returns ln(e / (1 − e)) of evidence, clipped away from 0 and 1."""
    inside = np.clip(evidence, 1 - _CERTAIN, _CERTAIN)
    return np.asarray(np.log(inside / (1 - inside)))


@cache
def default_name_model() -> NameModel:
    """Loads the model from `FILE`."""
    return NameModel.model_validate_json(FILE.read_text("utf-8"))


def load_name_model(detector: str, models: Path) -> NameModel | None:
    """Finds what was measured of a detector's scores; None if nothing was, or of other files.

    Raises `ModelUnavailableError` if the stored measurement is damaged.
    """
    if detector == default_name_model().detector:
        return default_name_model()
    try:
        folder = _folder(detector, models)
        found = NameModel.model_validate_json((folder / STORED).read_text("utf-8"))
    except (FileNotFoundError, ModelUnavailableError):  # never measured, or a closed-set detector of the user's own
        return None
    except (ValueError, OSError) as error:
        raise ModelUnavailableError(
            f"model {detector}: {STORED} in {folder} is damaged",
            field=detector,
            hint="Remove it, and calibrate the model again.",
        ) from error
    return found if found.sha256 == installed_digests(folder, name=folder.name) else None


def save_name_model(model: NameModel, models: Path) -> None:
    """Writes a measurement of a detector's present files into its folder."""
    folder = _folder(model.detector, models)
    stored = model.model_copy(update={"sha256": installed_digests(folder, name=folder.name)})
    (folder / STORED).write_text(json.dumps(stored.model_dump(mode="json"), indent=1) + "\n", "utf-8")


def _folder(detector: str, models: Path) -> Path:
    return models / find_model(detector, "open_set_detector")[1]
