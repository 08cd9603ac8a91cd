"""What things look like, compared with a text by an image-text model: evidence beside names, where no name answers.

A model answers only where it was calibrated, as its cosines alone mean nothing: `benchmarks/calibration` writes
`looks.json`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from fastsplat.service.common.logistic import logistic
from fastsplat.service.query.language.calibration import calibration_key
from fastsplat.service.query.language.probability import Logistic
from fastsplat.service.scene.types import Thing

if TYPE_CHECKING:  # onnxruntime loads when it is used
    from fastsplat.service.perception.types import TextEncoder

FILE = Path(__file__).with_name("looks.json")
"""Written by benchmarks/calibration; the product ships no such model, and measured none."""

_CLEAREST = 6.0
"""A log-likelihood ratio is clipped to this: a look makes nothing certain."""
_LIKELIEST = 0.999


class LooksCalibration(BaseModel):
    """The calibration of one image-text model.

    Attributes:
        ratio: the logarithm of how much likelier a thing's score is if the text is true of it; its lead is over the
            median of the scene's things.
        date: ISO date.
        figures: on rooms that set nothing.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    ratio: Logistic
    date: str
    figures: Mapping[str, float]


def looks_calibration(name: str, sha256: str) -> LooksCalibration | None:
    """The calibration of a model; None if it was not measured."""
    return _calibrations().get(calibration_key(name, sha256))


@dataclass(frozen=True)
class LooksModel:
    """A calibrated image-text model.

    Attributes:
        encoder: its network of texts.
        calibration: of the model.
    """

    encoder: TextEncoder
    calibration: LooksCalibration


@dataclass(frozen=True)
class ThingLooks:
    """The looks of the things of one scene. Threads may share it.

    Attributes:
        things: of the scene; only those count that this very model looked at.
        model: compares; None: nothing does.
    """

    things: tuple[Thing, ...] = field(repr=False)
    model: LooksModel | None

    def __bool__(self) -> bool:
        return bool(self._ids)

    @cached_property
    def _ids(self) -> tuple[int, ...]:
        return () if self.model is None else tuple(thing.id for thing in self._looked_at)

    @property
    def _looked_at(self) -> list[Thing]:
        known = "" if self.model is None else self.model.encoder.sha256
        return [thing for thing in self.things if thing.looks is not None and thing.looks.sha256 == known]

    @cached_property
    def _rows(self) -> NDArray[np.float64]:
        """float64 [K, E]."""
        looks = [thing.looks.embedding for thing in self._looked_at if thing.looks is not None]
        return np.stack([np.frombuffer(each, np.float16) for each in looks]).astype(np.float64)

    def likely(self, text: str, before: Mapping[int, float]) -> Mapping[int, float]:
        """0..1 for each thing that the model looked at: that a text is true of it, by its looks and what was known
        before.

        Args:
            text: a noun phrase.
            before: 0..1 of each of these things, without its looks.

        Raises:
            ModelUnavailableError: the network of texts embeds in another size.
        """
        if self.model is None or not self:
            return {}
        ratio = ratios_of(self._rows @ self.model.encoder.encode([text])[0], self.model.calibration.ratio)
        known = np.clip([before[each] for each in self._ids], 1 - _LIKELIEST, _LIKELIEST)
        together = logistic(np.log(known / (1 - known)) + ratio)
        return dict(zip(self._ids, together.tolist(), strict=True))


def scores_of(cosines: NDArray[np.floating]) -> NDArray[np.float64]:
    """float64 [K, 2]: of the cosines [K] of a scene's things with one text, and how far each leads over their median:
    what texts and pictures have in common is in all of them."""
    rows = np.asarray(cosines, np.float64)
    return np.stack([rows, rows - np.median(rows)], axis=1)


def ratios_of(cosines: NDArray[np.floating], ratio: Logistic) -> NDArray[np.float64]:
    """float64 [K]: log-likelihood ratios of `scores_of`."""
    weighed = scores_of(cosines) @ np.array([ratio.score, ratio.lead]) + ratio.offset
    return np.asarray(np.clip(weighed, -_CLEAREST, _CLEAREST))


@cache
def _calibrations() -> Mapping[str, LooksCalibration]:
    return {key: LooksCalibration.model_validate(value) for key, value in json.loads(FILE.read_text()).items()}
