"""The scale of a scene by lengths that people know: how it follows from them, and how a scene is scaled by it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from fastsplat.service.common.combined_ratios import NORMAL_95, combined_ratio
from fastsplat.service.common.similarity import scaled_camera
from fastsplat.service.scene.alignment import Alignment
from fastsplat_contract.scenes import ScaleSource

if TYPE_CHECKING:
    from fastsplat.service.scene.types import Scene

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


def scaled(scene: Scene, scaling: Scaling) -> Scene:
    """The scene with its Gaussians and cameras in meters by a scaling of its trained version; which thing a Gaussian
    belongs to, and what it looks like, stays."""
    before = 1.0 if scene.scaling is None else scene.scaling.meters_per_unit
    factor = scaling.meters_per_unit / before
    gaussians = scene.gaussians
    means = (gaussians.means.astype(np.float64) * factor).astype(np.float32)
    log_scales = (gaussians.log_scales.astype(np.float64) + math.log(factor)).astype(np.float32)
    return replace(
        scene,
        gaussians=replace(gaussians, means=means, log_scales=log_scales),
        cameras=tuple(scaled_camera(posed, factor) for posed in scene.cameras),
        scale="METRIC",
        scaling=scaling,
        alignment=_scaled_alignment(scene.alignment, factor),
    )


def _scaled_alignment(alignment: Alignment | None, factor: float) -> Alignment | None:
    """In the new units; lengths that pairs of points left over are not measured anew."""
    if alignment is None:
        return None
    x, y, z = alignment.translation
    return replace(
        alignment,
        translation=(x * factor, y * factor, z * factor),
        residuals=tuple(each * factor for each in alignment.residuals),
        rms=None if alignment.rms is None else alignment.rms * factor,
    )


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
