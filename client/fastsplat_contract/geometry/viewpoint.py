"""How a camera travels: a pinhole, and where it stands as position and quaternion. `camera.PosedCamera` reads it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from fastsplat_contract.codec.wire import Request
from fastsplat_contract.geometry.poses import Orientation, Vector3

Convention = Literal["OPENCV", "OPENGL"]
"""Camera axes: OpenCV is x right, y down, z forward; OpenGL (nerfstudio, Blender) is x right, y up, z backward."""

WORLD = "world"
"""The frame of a scene that is not aligned to a map."""


@dataclass(frozen=True)
class Intrinsics(Request):
    """A pinhole: (x, y, z) of the camera frame lands at (fx·x/z + cx, fy·y/z + cy); pixel centers at +0.5."""

    width: Annotated[int, Field(ge=1, description="pixels")]
    height: Annotated[int, Field(ge=1, description="pixels")]
    fx: Annotated[float, Field(gt=0, description="pixels")]
    fy: Annotated[float, Field(gt=0, description="pixels")]
    cx: Annotated[float, Field(description="pixels from the left edge; width / 2 is the middle")]
    cy: Annotated[float, Field(description="pixels from the top edge; height / 2 is the middle")]


@dataclass(frozen=True)
class PosedCamera(Request):
    """A camera and where it stands."""

    intrinsics: Intrinsics
    position: Annotated[Vector3, Field(description="the camera's center in the world frame, scene units")]
    orientation: Annotated[Orientation, Field(description="rotates camera axes into world axes (world_from_camera)")]
    convention: Annotated[
        Convention,
        Field(
            description="camera axes of `orientation`. OPENCV: x right, y down, z forward. OPENGL (nerfstudio, "
            "Blender): x right, y up, z backward. Answers always use OPENCV."
        ),
    ] = "OPENCV"
    frame_id: Annotated[
        str,
        Field(
            description="the frame of position and orientation: name of the map that the scene's version is aligned to "
            '("map" if it has none), else "world"; a request may also say "world", or leave it empty'
        ),
    ] = WORLD
    name: Annotated[str, Field(description="in answers, the image's name in the capture; ignored in requests")] = ""
