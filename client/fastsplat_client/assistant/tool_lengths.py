"""Lengths, places and frames in results: with their unit and interval, rounded to a tenth of a millimeter."""

from __future__ import annotations

import numpy as np

from fastsplat_client.assistant.tool_results import Interval, Point, Unit
from fastsplat_contract.geometry.poses import Box
from fastsplat_contract.messages.measurements import Length
from fastsplat_contract.messages.scenes import Scene, SceneSummary

_ALONG = float(np.cos(np.radians(0.1)))
"""Cosine of the angle within which an axis is said to be the vertical."""


def bounds_of(boxes: list[Box]) -> tuple[np.ndarray | None, np.ndarray | None]:
    """The axis-aligned box around oriented ones."""
    if not boxes:
        return None, None
    signs = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, -1).T
    corners = np.concatenate(
        [(signs * box.size) @ box.center.matrix()[:3, :3].T + box.center.matrix()[:3, 3] for box in boxes]
    )
    return corners.min(axis=0), corners.max(axis=0)


def rounded(values: np.ndarray) -> Point:
    """A place or an extent, [3], to four decimals."""
    x, y, z = (round(float(value), 4) for value in values)
    return (x, y, z)


def unit_of(scene: SceneSummary) -> Unit:
    """The unit of all lengths of a scene."""
    return "m" if scene.scale == "METRIC" else "scene units"


def unit_source(scene: Scene) -> str:
    """What says how long a scene unit is, as a sentence."""
    if scene.scale == "ARBITRARY":
        return "nothing says how long a scene unit is; say no length in meters"
    if scene.scaling is None:
        return "poses in meters came with the capture"
    scaling = scene.scaling
    share = 100 * (scaling.high - scaling.low) / 2 / scaling.meters_per_unit
    return f"{scaling.source}; lengths are right within {share:.1f} % in 95 % of cases"


def up_of(scene: Scene) -> str:
    """Which way is up, and how sure that is, as a sentence."""
    if scene.vertical is None:
        return "not known"
    up = scene.vertical.up
    axis = "+z" if up.z > _ALONG else f"({up.x:.3f}, {up.y:.3f}, {up.z:.3f})"
    return f"{axis}, by {scene.vertical.source}, within {2 * scene.vertical.deviation_deg:.1f} degrees"


def frame_of(scene: Scene) -> str:
    """The frame of all places of a scene, as words."""
    named = "" if scene.alignment is None else scene.alignment.frame
    return f"map frame {named!r}" if named else "the scene's own world frame"


def interval_of(length: Length | None) -> Interval | None:
    """A measured length; None for one that was not measured."""
    return None if length is None else known_length(length)


def known_length(length: Length) -> Interval:
    """A measured length with its 95 % interval."""
    return Interval(round(length.value, 4), round(length.low, 4), round(length.high, 4))


def spoken(length: Interval, unit: Unit) -> str:
    """A length in words."""
    return f"{length.value:g} {unit} (95 %: {length.low:g} to {length.high:g})"
