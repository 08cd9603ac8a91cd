"""Estimates a scene's metric scale from known lengths."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, get_args

from pydantic import Field, TypeAdapter

from fastsplat.service.common.combined_ratios import NORMAL_95, combined_ratio
from fastsplat.service.scene.artefact.scene_facts import SceneFacts
from fastsplat_contract.messages.scenes import ScaleSource

_Positive = Annotated[float, Field(gt=0)]
_Deviation = Annotated[float, Field(ge=0)]
_LEAST_DEVIATION = 1e-3
"""Minimum relative deviation of a length between two picked places."""


@dataclass(frozen=True)
class ScaledLength:
    """A known length with standard deviations."""

    units: _Positive  # in units of the trained scene
    deviation: _Deviation  # of `units`
    meters: _Positive  # as measured in the world
    meters_deviation: _Deviation  # of `meters`


@dataclass(frozen=True)
class Scaling:
    """Scale of a version relative to the trained one."""

    meters_per_unit: _Positive  # factor applied to the trained version's arrays and cameras
    low: _Positive  # of the 95 % interval
    high: _Positive  # of the 95 % interval
    lengths: tuple[ScaledLength, ...]

    @property
    def deviation(self) -> float:
        """Relative standard deviation of metric lengths due to the scale alone."""
        return math.log(self.high / self.low) / (2 * NORMAL_95)


def combined(lengths: Sequence[ScaledLength]) -> Scaling:
    """Fits the scale to one or more positive known lengths.

    `combined_ratio` of meters_i / units_i, with the variances (σ_units / units)², at least 0.001², + (σ_meters /
    meters)². The interval is s · exp(±1.96 σ).
    """
    variances = [
        max((length.deviation / length.units) ** 2, _LEAST_DEVIATION**2)
        + (length.meters_deviation / length.meters) ** 2
        for length in lengths
    ]
    scale, deviation = combined_ratio([length.meters / length.units for length in lengths], variances)
    spread = math.exp(NORMAL_95 * deviation)
    return Scaling(scale, scale / spread, scale * spread, tuple(lengths))


def capture_scaling(facts: SceneFacts) -> Scaling | None:
    """Returns the uncertainty of meters measured by the capture itself; None without any.

    The trained version is already in meters: the scaling is 1, with one length, so that known lengths combine with it.
    """
    error = facts.scale_error_95
    if error is None or not error > 0:
        return None
    return combined([ScaledLength(1.0, error / NORMAL_95, 1.0, 0.0)])


def capture_scale_source(facts: SceneFacts) -> ScaleSource:
    """Returns the surest source of the capture's meters ("tags+arkit": tags).

    Scenes that record none used tags.
    """
    stated = (facts.scale_source or "tags").partition("+")[0]
    return next((source for source in get_args(ScaleSource) if source == stated), "tags")


_JSON: TypeAdapter[Scaling | None] = TypeAdapter(Scaling | None)


def scaling_to_json(scaling: Scaling | None) -> dict[str, Any] | None:
    """Converts a scaling to JSON values."""
    row: dict[str, Any] | None = _JSON.dump_python(scaling, mode="json")
    return row


def scaling_from_json(row: Mapping[str, Any] | None) -> Scaling | None:
    """Reads the output of `scaling_to_json`; raises `ValueError` for malformed values."""
    return _JSON.validate_python(row)
