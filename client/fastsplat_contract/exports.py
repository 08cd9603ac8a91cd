"""A scene as a file for other programs, or for people without the server."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from fastsplat_contract.queries import Version
from fastsplat_contract.wire import Many, Request

ExportFormat = Literal["ply", "spz", "html", "points", "glb", "mesh", "cameras", "sog", "mcap", "map", "rerun"]
"""What `ExportRequest.format` describes."""

FILE_NAMES: Mapping[ExportFormat, str] = {
    "ply": "scene.ply",
    "spz": "scene.spz",
    "html": "scene.html",
    "points": "scene.points.ply",
    "glb": "scene.glb",
    "mesh": "scene.mesh.glb",
    "cameras": "scene.cameras.zip",
    "sog": "scene.sog",
    "mcap": "scene.mcap",
    "map": "scene.map.zip",
    "rerun": "scene.rrd",
}
"""Of each format, as a browser saves it."""


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
            "own names; rows in their order in these three; points: a labelled point cloud of the surfaces, as PLY; "
            "glb: glTF with KHR_gaussian_splatting, a node for each thing, and the cameras; mesh: the "
            "surfaces as triangles, GLB, a node for each thing; cameras: a zip of nerfstudio's transforms.json and "
            "COLMAP's binary model, with the points; sog: PlayCanvas' SOG, the smallest, rows in Morton order; "
            "mcap: for Foxglove: boxes with names, labelled points, cameras with their stored photos, frames, floor "
            "map; map: a zip of map.pgm and map.yaml, the free and occupied floor as nav2's map_server reads it, of "
            "whole scenes in metres with z up; rerun: for Rerun: the splat, boxes with names, cameras with their "
            "stored photos"
        ),
    ] = "ply"
    version: Version = ""
    things: Annotated[
        Many[int], Field(description="only the Gaussians of these things, by id, in their order; empty: all")
    ] = ()
    cell: Annotated[
        float,
        Field(
            ge=0,
            description="of points, cameras and mcap: the distance between points, of mesh: the width of its voxels, "
            "of map: the width of its cells, scene units; 0: as fine as the views are, 0.05 m for map",
        ),
    ] = 0.0
