"""The scale of a scene by lengths that people know: how it follows from them, and how a scene is scaled by it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, get_args

from fastsplat.service.common.combined_ratios import NORMAL_95, combined_ratio
from fastsplat_contract.scenes import ScaleSource

_LEAST_DEVIATION = 1e-3
"""Relative, of a length between two places: nobody picks a place better."""


@dataclass(frozen=True)
class ScaledLength:
    """One known length.

    Attributes:
        units: the same length in units of the scene as it was trained.
        deviation: standard deviation of `units`.
        meters: as it was measured in the world.
        meters_deviation: standard deviation of `meters`.
    """

    units: float
    deviation: float
    meters: float
    meters_deviation: float


@dataclass(frozen=True)
class Scaling:
    """How the lengths of a version follow from those of the trained one.

    Attributes:
        meters_per_unit: of the trained version; arrays and cameras of this one are multiplied by it.
        low, high: its 95 % interval.
        lengths: that it comes from.
    """

    meters_per_unit: float
    low: float
    high: float
    lengths: tuple[ScaledLength, ...]

    @property
    def deviation(self) -> float:
        """Relative standard deviation of every length in meters that comes from the scale alone."""
        return math.log(self.high / self.low) / (2 * NORMAL_95)


def combined(lengths: Sequence[ScaledLength]) -> Scaling:
    """The scale that fits several known lengths best.

    `combined_ratio` of meters_i / units_i, with the variances (σ_units / units)², at least 0.001², + (σ_meters /
    meters)². The interval is s · exp(±1.96 σ).

    Args:
        lengths: at least one, all positive.
    """
    variances = [
        max((each.deviation / each.units) ** 2, _LEAST_DEVIATION**2) + (each.meters_deviation / each.meters) ** 2
        for each in lengths
    ]
    scale, deviation = combined_ratio([each.meters / each.units for each in lengths], variances)
    spread = math.exp(NORMAL_95 * deviation)
    return Scaling(scale, scale / spread, scale * spread, tuple(lengths))


def capture_scaling(quality: Mapping[str, Any]) -> Scaling | None:
    """How sure the meters are that the capture itself measured, by tags or a phone; None where it measured none.

    The trained version is in these meters already: the scaling is 1, and has one length, so that known lengths are
    combined with it.

    Args:
        quality: as in `Scene.quality`; `scale_error_95` is half of the 95 % interval as a share.
    """
    error = quality.get("scale_error_95")
    if not isinstance(error, float) or not error > 0:
        return None
    return combined([ScaledLength(1.0, error / NORMAL_95, 1.0, 0.0)])


def capture_scale_source(quality: Mapping[str, Any]) -> ScaleSource:
    """What the capture's meters were measured by, of several the surest ("tags+arkit": tags); scenes whose `quality`
    does not say it had tags."""
    stated = str(quality.get("scale_source", "tags")).partition("+")[0]
    return next((source for source in get_args(ScaleSource) if source == stated), "tags")


def scaling_to_json(scaling: Scaling | None) -> dict[str, Any] | None:
    """A scaling as plain numbers."""
    return None if scaling is None else {**asdict(scaling), "lengths": [asdict(each) for each in scaling.lengths]}


def scaling_from_json(row: Mapping[str, Any] | None) -> Scaling | None:
    """What `scaling_to_json` wrote."""
    if row is None:
        return None
    return Scaling(
        row["meters_per_unit"], row["low"], row["high"], tuple(ScaledLength(**each) for each in row["lengths"])
    )
