"""Places to measure between, and lengths between two of them that somebody knows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.poses import Vector3
from fastsplat_contract.thing_prompts import Pixel
from fastsplat_contract.wire import Request


@dataclass(frozen=True)
class Place(Request):
    """One place of a scene: what a view shows at a pixel, a point of the world, or a whole thing."""

    camera: Annotated[PosedCamera | None, Field(description="a free viewpoint, for a pixel")] = None
    view: Annotated[str | None, Field(description="name of one of the scene's own cameras, instead of `camera`")] = None
    pixel: Annotated[Pixel | None, Field(description="of the camera or view: the surface that it shows there")] = None
    point: Annotated[Vector3 | None, Field(description="in the world frame, instead of `pixel`")] = None
    thing: Annotated[int | None, Field(description="id of a thing, instead of `pixel`: its surface and its box")] = None


@dataclass(frozen=True)
class KnownLength(Request):
    """The distance between two places as somebody has measured it in the world."""

    first: Annotated[Place, Field(description="a pixel or a point")]
    second: Annotated[Place, Field(description="a pixel or a point")]
    meters: Annotated[float, Field(gt=0, description="between the two")]
    plus_minus: Annotated[
        float, Field(ge=0, description="meters: how far off `meters` may be, in 95 % of cases; 0: exact")
    ] = 0.0
