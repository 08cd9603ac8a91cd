"""Places to measure between, and lengths between two of them that somebody knows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Many, OneOf, Request, travels
from fastsplat_contract.geometry.camera import PosedCamera, ViewName
from fastsplat_contract.geometry.object_prompts import Pixel
from fastsplat_contract.geometry.poses import Pose, Vector3


@dataclass(frozen=True)
class Place(Request):
    """One place of a scene: what a view shows at a pixel, a point of the world, or a whole object."""

    camera: Annotated[PosedCamera | None, OneOf("viewpoint"), Field(description="a free viewpoint, for a pixel")] = None
    view: ViewName = None
    pixel: Annotated[
        Pixel | None, OneOf("place"), Field(description="of the camera or view: the surface that it shows there")
    ] = None
    point: Annotated[Vector3 | None, OneOf("place"), Field(description="in the world frame, instead of `pixel`")] = None
    object_id: Annotated[
        int | None, OneOf("place"), Field(description="id of an object, instead of `pixel`: its surface and its box")
    ] = None


@dataclass(frozen=True)
class KnownLength(Request):
    """The distance between two places as somebody has measured it in the world."""

    first: Annotated[Place, Field(description="a pixel or a point")]
    second: Annotated[Place, Field(description="a pixel or a point")]
    meters: Annotated[float, Field(gt=0, description="between the two")]
    plus_minus: Annotated[
        float, Field(ge=0, description="meters: how far off `meters` may be, in 95 % of cases; 0: exact")
    ] = 0.0


ObjectSide = Literal["longest", "height"]


@dataclass(frozen=True)
class KnownSize(Request):
    """How large an object is, as somebody has measured it in the world."""

    object_id: Annotated[int, Field(description="its id")]
    meters: Annotated[float, Field(gt=0, description="along that side of its box")]
    plus_minus: Annotated[
        float, Field(ge=0, description="meters: how far off `meters` may be, in 95 % of cases; 0: exact")
    ] = 0.0
    side: Annotated[
        ObjectSide,
        Field(description="longest: the box's longest side; height: the side that points up, in an upright box"),
    ] = "longest"


@travels(request=True)
class PointPair(NamedTuple):
    """One place, in the scene and in a map."""

    scene: Annotated[Vector3, Field(description="in the world frame of the version that is current")]
    map: Annotated[Vector3, Field(description="the same place in the map's frame, meters")]


@dataclass(frozen=True)
class Alignment(Request):
    """How a scene is put into the frame of a map: by a rigid motion, or by pairs of points."""

    frame: Annotated[str, Field(description="name of the map's frame, as map; one line of at most 200 characters")] = ""
    transform: Annotated[
        Pose | None, Field(description="x' = R x + t from the world frame of the current version into the map's")
    ] = None
    pairs: Annotated[
        Many[PointPair],
        Field(
            description="three or more, not on one line, instead of `transform`; a scene whose units are not meters is "
            "scaled to meters by them"
        ),
    ] = ()
