"""Estimates meters from a phone's tracking and depth sensor; scales captures to meters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.captures import Capture, ScaleEstimate, View
from fastsplat.service.capture.formats.depth_maps import inner_pixels, load_depth
from fastsplat.service.common.combined_ratios import NORMAL_95, combined_ratio
from fastsplat.service.common.similarity import scaled_camera

TRACKING_ERROR_95 = 0.05
"""Relative, of ARKit's lengths: 2.5 % (1 σ) at a slow walk of 0.8 m/s.

It drifts by 0.02 m/s (Kim et al. 2022, Sensors 22, 9873, the best of four trackers).
"""
SENSOR_ERROR_95 = 0.02
"""Relative, alike in all views: 1 cm at 1–2 m (Luetzenburg et al. 2021)."""
MOST_DISAGREEMENT = 0.1
"""Relative difference beyond which metric poses and depths contradict each other."""
_LEAST_POINTS, _LEAST_VIEWS = 10, 3
_LEAST_DEVIATION = 1e-6
_SAME_SURFACE = 0.25
"""Relative difference from the median beyond which a depth is of another surface."""


def depth_ratio(views: Sequence[View], points: NDArray[np.float32]) -> tuple[float, float] | None:
    """Estimates a world unit's length in depth map units, and its relative standard error.

    The median over views of each view's median ratio (error 1.2533 σ/√n by the median absolute deviation); None if
    there are too few.

    Args:
        points: [P, 3] triangulated, world.
    """
    ratios = []
    for view in views:
        if view.depth is None:
            continue
        depth = load_depth(view.depth)
        _, pixels, distances = replace(view.posed, camera=view.depth.camera).in_picture(points)
        columns, rows = pixels.astype(np.intp).T
        ratio = (depth[rows, columns] / distances)[inner_pixels(depth)[rows, columns]]
        if len(ratio) >= _LEAST_POINTS:
            ratio = ratio[np.abs(ratio / np.median(ratio) - 1) <= _SAME_SURFACE]
        if len(ratio) >= _LEAST_POINTS:
            ratios.append(float(np.median(ratio)))
    if len(ratios) < _LEAST_VIEWS:
        return None
    middle = float(np.median(ratios))
    spread = 1.4826 * float(np.median(np.abs(np.array(ratios) / middle - 1)))
    return middle, 1.2533 * spread / math.sqrt(len(ratios))


def sensor_estimate(ratio: float, standard_error: float) -> ScaleEstimate:
    """Converts a `depth_ratio` of metric depth maps to a scale."""
    return ScaleEstimate("sensor_depth", ratio, math.hypot(SENSOR_ERROR_95, NORMAL_95 * standard_error))


def combined_estimate(first: ScaleEstimate, second: ScaleEstimate) -> ScaleEstimate:
    """Combines two independent estimates in the same units by `combined_ratio`."""
    surest = sorted((first, second), key=lambda estimate: estimate.relative_error_95)
    variances = [max(estimate.relative_error_95 / NORMAL_95, _LEAST_DEVIATION) ** 2 for estimate in surest]
    ratio, deviation = combined_ratio([estimate.meters_per_unit for estimate in surest], variances)
    return ScaleEstimate("+".join(estimate.source for estimate in surest), ratio, NORMAL_95 * deviation)


def metric_capture(capture: Capture, estimate: ScaleEstimate) -> Capture:
    """Scales a capture to meters by an estimate of its unit, combined with earlier ones.

    The report's scale is of the first unit.
    """
    before, both = capture.report.scale, estimate
    if before is not None:
        both = combined_estimate(replace(before, meters_per_unit=1.0), estimate)
    first = 1.0 if before is None else before.meters_per_unit
    factor = both.meters_per_unit
    return replace(
        capture,
        views=tuple(scaled_view(view, factor) for view in capture.views),
        points=(capture.points * np.float32(factor)).astype(np.float32),
        scale="METRIC",
        report=replace(capture.report, scale=replace(both, meters_per_unit=first * factor)),
    )


def scaled_view(view: View, factor: float) -> View:
    """Scales a view so that one of its units becomes `factor`."""
    depth = None if view.depth is None else replace(view.depth, unit=view.depth.unit * factor)
    return replace(view, posed=scaled_camera(view.posed, factor), depth=depth)
