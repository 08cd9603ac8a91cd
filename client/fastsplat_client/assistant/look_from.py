"""A picture for an assistant: of an object from where it is seen best, or from a free place."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from mcp.server.mcpserver import Image
from numpy.typing import NDArray
from pydantic import Field

from fastsplat_client.assistant.tools import Point, SceneName, resolve_scene
from fastsplat_client.client import Client
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.poses import look_at
from fastsplat_contract.messages.scenes import Color, Scene
from fastsplat_contract.photos.pictures import Tint

_MOST_PIXELS_A_SIDE = 768
_HIGHLIGHT = Color(1.0, 0.55, 0.0)
_FREE_ANGLE = np.deg2rad(60.0)


def look_from(
    client: Client,
    object_id: Annotated[int, Field(ge=0, le=65535, description="id of an object to tint orange; 0: none")] = 0,
    view: Annotated[str, Field(description="name of one of the scene's photos to look from")] = "",
    position: Annotated[Point | None, Field(description="x, y, z to stand at, instead of view")] = None,
    target: Annotated[Point | None, Field(description="x, y, z to look at, with position")] = None,
    scene: SceneName = "",
) -> Image:
    """A picture of the scene: from where an object is seen best, from one of its photos, or from any place."""
    scene_info = resolve_scene(client, scene)
    if (position is None) != (target is None) or (view and position is not None):
        raise InvalidInputError(
            "a viewpoint is a view's name, or a position with a target",
            field="view" if view else "position",
            hint="Send view, or position and target, or an object alone.",
        )
    viewpoint: str | PosedCamera
    if position is not None and target is not None:
        viewpoint = free_view(np.array(position), np.array(target), _up(scene_info))
    else:
        if object_id and not view:
            best = client.best_views(scene_info.id, object_id, max_views=1)
            if not best:
                raise InvalidInputError(f"no camera of the scene sees object {object_id}", field="object_id")
            view = best[0].view
        posed = next((posed for posed in scene_info.cameras if view in ("", posed.name)), None)
        viewpoint = replace(posed.limited_to(_MOST_PIXELS_A_SIDE), name="") if posed else view
    tints = [Tint((object_id,), _HIGHLIGHT, 0.55)] if object_id else []
    jpeg = client.picture(
        scene_info.id, "rgb", viewpoint, image_format="jpeg", tints=tints, dimming=0.4 if object_id else 0.0
    )
    return Image(data=jpeg, format="jpeg")


def free_view(position: NDArray[np.float64], target: NDArray[np.float64], up: NDArray[np.float64]) -> PosedCamera:
    """A pinhole camera [3] -> [3] of 60° whose picture's up is `up` (unit, world) as nearly as can be.

    Raises:
        InvalidInputError: not finite, or position and target are one.
    """
    length = float(np.linalg.norm(target - position))
    if not np.isfinite(length) or length < 1e-9:
        raise InvalidInputError("position and target are one place", field="target", hint="Look at some other place.")
    side = _MOST_PIXELS_A_SIDE
    focal = side / 2 / float(np.tan(_FREE_ANGLE / 2))
    camera = Camera(side, side * 3 // 4, focal, focal, side / 2, side * 3 / 8)
    return PosedCamera(camera, look_at(position, target, up))


def _up(scene: Scene) -> NDArray[np.float64]:
    """Unit [3]: the scene's vertical; where nothing says what that is, what the cameras hold for up."""
    if scene.vertical is not None:
        return np.array(scene.vertical.up)
    cameras = scene.cameras
    total = np.sum([-camera.world_from_camera[:3, 1] for camera in cameras], axis=0) if cameras else np.zeros(3)
    length = float(np.linalg.norm(total))
    return total / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
