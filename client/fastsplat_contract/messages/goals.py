"""Where a robot stands to see an object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from fastsplat_contract.codec.wire import Response
from fastsplat_contract.geometry.poses import Pose

FloorSource = Literal["surface", "lowest_level"]
"""What said where the floor is: an object that is a floor, or the lowest level with many points that face up."""


@dataclass(frozen=True)
class Goal(Response):
    """The free place nearest to an object from which a robot sees it, in the scene's frame: meters, z up."""

    pose: Annotated[Pose, Field(description="on the floor, x ahead: turned to the middle of the object's box")]
    yaw: Annotated[float, Field(description="the same turn about z, radians, 0 along x")]
    distance: Annotated[float, Field(description="from the place to the object's box, level, meters")]
    clearance: Annotated[
        float, Field(description="from the place to the nearest cell of the map that is not free, meters, at least")
    ]
    object_id: Annotated[int, Field(description="which object")]
    version: Annotated[str, Field(description="which version was read")]
    floor_source: Annotated[
        FloorSource,
        Field(
            description="by what the floor was found: surface, an object that is a floor; lowest_level, the lowest "
            "level with many points that face up"
        ),
    ]
