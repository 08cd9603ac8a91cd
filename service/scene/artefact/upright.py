"""Vertical direction of a scene version and its uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.vertical import level_deviation, vertical_of_poses
from fastsplat.service.scene.artefact.alignment import Alignment
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import vector3
from fastsplat_contract.messages.scenes import SceneVertical, VerticalSource

F64 = NDArray[np.float64]

_MOST_DEVIATION_DEG = 10.0
"""Largest usable 1 sigma: above that of level cameras, below that of down-looking ones."""


def vertical_figures(source: VerticalSource, deviation_deg: float) -> dict[str, Any]:
    """Quality entries for the capture's vertical, which is +z of the trained version."""
    return {"vertical_source": source, "vertical_deviation_deg": deviation_deg}


def vertical_of(
    quality: Mapping[str, Any], alignment: Alignment | None, cameras: Sequence[PosedCamera]
) -> SceneVertical | None:
    """Returns the vertical in the version's frame; None if unknown.

    Uses the capture's recorded vertical (`vertical_figures`), rotated by the alignment, else the poses
    (`vertical_of_poses`).
    """
    stated, deviation = quality.get("vertical_source"), quality.get("vertical_deviation_deg")
    source: VerticalSource | None = next((each for each in get_args(VerticalSource) if each == stated), None)
    if source is not None and isinstance(deviation, (int, float)) and math.isfinite(deviation):
        rotation = np.eye(3) if alignment is None else np.array(alignment.rotation)
        return SceneVertical(source, float(deviation), vector3(rotation[:, 2]))
    if not cameras:
        return None
    poses = np.stack([posed.world_from_camera for posed in cameras])
    up = vertical_of_poses(poses)
    return None if up is None else SceneVertical("horizon", level_deviation(poses, up), vector3(up))


def up_of(vertical: SceneVertical | None) -> F64 | None:
    """Returns the unit up vector, float64 [3]; None above 10 degrees (1 sigma)."""
    if vertical is None or vertical.deviation_deg > _MOST_DEVIATION_DEG:
        return None
    return np.array(vertical.up, dtype=np.float64)
