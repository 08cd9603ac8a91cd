"""A scene as a file for other programs, or for people without the server."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from fastsplat_contract.codec.wire import Many, Request
from fastsplat_contract.messages.scenes import Version

ExportFormat = Literal[
    "ply", "spz", "html", "points", "mesh", "cameras", "sog", "mcap", "map",
    "camera_list", "transforms", "colmap", "objects", "spz4",
]  # fmt: skip
"""The rows of `FORMATS`."""


@dataclass(frozen=True)
class FormatFacts:
    """One format.

    Attributes:
        ending: of its files' names, without the leading dot.
        media_type: as HTTP names it.
        description: what it is; ends a sentence that its name begins.
        cell: what the cell of a request is for it; "": it has none.
        whole: what a file of it is, as a sentence begins, where it is of whole scenes alone; else "".
    """

    ending: str
    media_type: str
    description: str
    cell: str = ""
    whole: str = ""


FORMATS: Mapping[ExportFormat, FormatFacts] = {
    "ply": FormatFacts("ply", "application/x-ply", "as 3D Gaussian splatting viewers open it, exact to the bit"),
    "spz": FormatFacts("spz", "application/octet-stream", "Niantic's compressed splat, less than a quarter of that"),
    "html": FormatFacts(
        "html",
        "text/html",
        "one page that opens from disk, shows the scene and answers its own names; rows in their order in these three",
        whole="a page",
    ),
    "points": FormatFacts(
        "points.ply",
        "application/x-ply",
        "a labelled point cloud of the surfaces, as PLY",
        cell="the distance between points",
    ),
    "mesh": FormatFacts(
        "glb",
        "model/gltf-binary",
        "the surfaces as triangles, GLB, a node for each object, and the cameras",
        cell="the width of its voxels",
    ),
    "cameras": FormatFacts(
        "cameras.zip",
        "application/zip",
        "a zip of nerfstudio's transforms.json and COLMAP's binary model, with the points",
        cell="the distance between points",
    ),
    "sog": FormatFacts("sog", "application/octet-stream", "PlayCanvas' SOG, the smallest, rows in Morton order"),
    "mcap": FormatFacts(
        "mcap",
        "application/octet-stream",
        "for Foxglove and Rerun: named boxes, labelled points, cameras with their stored photos, frames, floor map",
        cell="the distance between points",
    ),
    "map": FormatFacts(
        "map.zip",
        "application/zip",
        "a zip of map.pgm and map.yaml, the free and occupied floor as nav2's map_server reads it, of whole scenes in "
        "meters with z up",
        cell="the width of its cells",
        whole="a map",
    ),
    "camera_list": FormatFacts("cameras.json", "application/json", '{"cameras": [PosedCamera, ...]}', whole="cameras"),
    "transforms": FormatFacts(
        "transforms.json", "application/json", "nerfstudio's transforms.json, OpenGL axes", whole="cameras"
    ),
    "colmap": FormatFacts(
        "colmap.zip",
        "application/zip",
        "a zip of COLMAP's cameras.txt, images.txt and an empty points3D.txt",
        whole="cameras",
    ),
    "objects": FormatFacts(
        "objects.bin",
        "application/octet-stream",
        "which object each Gaussian belongs to, little-endian uint16 by row, 0 for none",
        whole="ids",
    ),
    "spz4": FormatFacts(
        "v4.spz", "application/octet-stream", "SPZ of version 4, one zstd stream a column; rows as in spz"
    ),
}
"""All that is known of a format but what writes it, which is in the service."""

FILE_NAMES: Mapping[ExportFormat, str] = {name: f"scene.{facts.ending}" for name, facts in FORMATS.items()}
"""Of each format, as a browser saves it."""


def _cells() -> str:
    """What a cell is, with the formats that it is so of."""
    formats: dict[str, list[str]] = {}
    for name, facts in FORMATS.items():
        if facts.cell:
            formats.setdefault(facts.cell, []).append(name)
    lists = {cell: " and ".join(filter(None, (", ".join(names[:-1]), names[-1]))) for cell, names in formats.items()}
    return ", ".join(f"of {names}: {cell}" for cell, names in lists.items())


@dataclass(frozen=True)
class ExportRequest(Request):
    """A version of a scene as one file."""

    proto: ClassVar[str] = "ExportSceneRequest"

    scene_id: Annotated[str, Field(description="which scene")]
    format: Annotated[
        ExportFormat, Field(description="; ".join(f"{name}: {facts.description}" for name, facts in FORMATS.items()))
    ] = "ply"
    version: Version = ""
    object_ids: Annotated[
        Many[int],
        Field(description="only the Gaussians of these objects, parts or groups, by id, in their order; empty: all"),
    ] = ()
    cell: Annotated[
        float, Field(ge=0, description=f"{_cells()}, scene units; 0: as fine as the views are, 0.05 m for map")
    ] = 0.0
    coarse: Annotated[
        bool,
        Field(
            description="of spz, for whole scenes: a large scene in about 60,000 Gaussians, each for those left out, "
            "of one color from all sides, in rows of their own"
        ),
    ] = False
