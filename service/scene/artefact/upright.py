"""Vertical direction of a scene version and its uncertainty."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.vertical import level_deviation, vertical_of_poses
from fastsplat.service.scene.artefact.alignment import Alignment
from fastsplat.service.scene.artefact.scene_facts import SceneFacts
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import vector3
from fastsplat_contract.messages.scenes import SceneVertical, VerticalSource

F64 = NDArray[np.float64]

_MOST_DEVIATION_DEG = 10.0
"""Largest usable 1 sigma: above that of level cameras, below that of down-looking ones."""


def vertical_of(facts: SceneFacts, alignment: Alignment | None, cameras: Sequence[PosedCamera]) -> SceneVertical | None:
    """Returns the vertical in the version's frame; None if unknown.

    Uses the capture's recorded vertical, rotated by the alignment, else the poses
    (`vertical_of_poses`).
    """
    deviation = facts.vertical_deviation_deg
    source: VerticalSource | None = next((s for s in get_args(VerticalSource) if s == facts.vertical_source), None)
    if source is not None and deviation is not None and math.isfinite(deviation):
        rotation = np.eye(3) if alignment is None else np.array(alignment.rotation)
        return SceneVertical(source, deviation, vector3(rotation[:, 2]))
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
