"""Lengths in a scene: between two places, and of an object; in meters only where the scene's scale is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Many, Request, Response, travels
from fastsplat_contract.geometry.places import Place
from fastsplat_contract.geometry.poses import Box, Vector3
from fastsplat_contract.messages.scenes import OfScene, Version


@dataclass(frozen=True)
class MeasureIn(Request):
    """What to measure: one place to locate it, one object for its size, two places for what is between them."""

    proto: ClassVar[str] = "MeasureRequest"

    places: Annotated[Many[Place], Field(description="one or two")]
    version: Version = ""


@dataclass(frozen=True)
class MeasureRequest(MeasureIn, OfScene):
    """What to measure: one place to locate it, one object for its size, two places for what is between them."""


@travels(request=False)
class Length(NamedTuple):
    """A length and the interval that has it in 95 % of cases, in meters or in scene units."""

    value: float
    low: Annotated[float, Field(description="of the 95 % interval")]
    high: Annotated[float, Field(description="of the 95 % interval")]


@travels(request=False)
class LocatedPlace(NamedTuple):
    """Where a place is."""

    point: Annotated[Vector3, Field(description="world frame; of an object the middle of its box")]
    plus_minus: Annotated[
        float, Field(description="how far off the point may be in its least certain direction, in 95 % of cases")
    ]
    object_id: Annotated[int, Field(description="the object there, see SceneObject; 0 for none")] = 0


@dataclass(frozen=True)
class Measurement(Response):
    """What was measured. Lengths are in meters where `meters` says so, otherwise in units of the scene alone."""

    places: Annotated[Many[LocatedPlace], Field(description="in the order of the request")]
    distance: Annotated[
        Length | None, Field(description="between two places; of an object from its nearest surface; absent for one")
    ]
    center_distance: Annotated[
        Length | None, Field(description="the same from the middles of objects' boxes; absent where there is no object")
    ]
    sides: Annotated[Many[Length], Field(description="of one object: its edges along its box's x, y and z axes")]
    box: Annotated[Box | None, Field(description="of one object; absent otherwise")]
    meters: Annotated[bool, Field(description="whether lengths are meters")]
    version: Annotated[str, Field(description="which version was read")]
