"""A scene as a file for other programs, or for people without the server."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from fastsplat_contract.queries import Version
from fastsplat_contract.wire import Many, Request

ExportFormat = Literal["ply", "spz", "html"]
"""What `ExportRequest.format` describes."""


@dataclass(frozen=True)
class ExportRequest(Request):
    """A version of a scene as one file."""

    proto: ClassVar[str] = "ExportSceneRequest"

    scene_id: Annotated[str, Field(description="which scene")]
    format: Annotated[
        ExportFormat,
        Field(
            description="ply: as 3D Gaussian splatting viewers open it, exact to the bit; spz: Niantic's compressed "
            "splat, less than a quarter of that; html: one page that opens from disk, shows the scene and answers its "
            "own names; rows in their order in all"
        ),
    ] = "ply"
    version: Version = ""
    things: Annotated[
        Many[int], Field(description="only the Gaussians of these things, by id, in their order; empty: all")
    ] = ()
