"""Which way is up in a version of a scene, by the best that is known, and how sure that is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.vertical import level_deviation, vertical_of_poses
from fastsplat.service.scene.alignment import Alignment
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.poses import vector3
from fastsplat_contract.scenes import SceneVertical, VerticalSource

F64 = NDArray[np.float64]

_MOST_DEVIATION_DEG = 10.0
"""1 sigma beyond which a vertical is a guess: it lies between that of level cameras and the mean of what cameras that
look down have for up."""


def vertical_figures(source: VerticalSource, deviation_deg: float) -> dict[str, Any]:
    """What a scene's quality says of the vertical of its capture, which is +z of the trained version."""
    return {"vertical_source": source, "vertical_deviation_deg": deviation_deg}


def vertical_of(
    quality: Mapping[str, Any], alignment: Alignment | None, cameras: Sequence[PosedCamera]
) -> SceneVertical | None:
    """The vertical in the frame of a version: the recorded one of its capture, turned as the version was aligned since;
    without one, what its cameras tell (see `vertical_of_poses`); None where they do not tell.

    Args:
        quality: as in `Scene.quality`, see `vertical_figures`.
        alignment: of the version.
        cameras: in the frame of the version.
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
    """float64 [3], the unit vector up; None where it is not known to within 10 degrees (1 sigma)."""
    if vertical is None or vertical.deviation_deg > _MOST_DEVIATION_DEG:
        return None
    return np.array(vertical.up, dtype=np.float64)
