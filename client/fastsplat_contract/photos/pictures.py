"""Pictures of a view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Many, OneOf, Request, travels
from fastsplat_contract.geometry.camera import PosedCamera, ViewName
from fastsplat_contract.messages.scenes import Color, OfScene, Version

PictureKind = Literal[
    "rgb", "overlay", "relevancy", "mask", "label_map", "depth", "depth_picture", "object_map", "objects", "normals",
    "confidence",
]  # fmt: skip
PictureFormat = Literal["png", "npy", "jpeg"]


@travels(request=True)
class Tint(NamedTuple):
    """A color over some objects of a picture."""

    object_ids: Annotated[Many[int], Field(description="ids of objects, parts and groups")]
    color: Annotated[Color, Field(description="RGB, each 0 to 1")]
    strength: Annotated[
        float, Field(ge=0, le=1, description="how much of their own color it covers: 0 nothing, 1 all of it")
    ]


@dataclass(frozen=True)
class RenderIn(Request):
    """One picture from a free viewpoint, or from one of the scene's own cameras."""

    proto: ClassVar[str] = "RenderViewRequest"

    kind: Annotated[
        PictureKind,
        Field(
            description="rgb: the view; overlay: the answer's mask over it; relevancy: in turbo colors; mask: 0 and "
            "255; label_map: 16-bit label ids, 0 undetected; depth: 16-bit camera z / depth_scale, 0 nothing, 65535 so "
            "far or farther; depth_picture: depth in turbo colors; object_map: 16-bit ids of objects, 0 none; objects: "
            "every object in a color of its own, with its name; normals: of surfaces, world frame, towards the camera, "
            "8-bit (n + 1) / 2, black nothing; confidence: how far depth and normal can be relied on, 16-bit, 65535 "
            "is 1"
        ),
    ]
    text: Annotated[str | None, Field(description="the question; overlay, relevancy and mask need one")] = None
    camera: Annotated[PosedCamera | None, OneOf("viewpoint"), Field(description="a free viewpoint")] = None
    view: ViewName = None
    version: Version = ""
    format: Annotated[
        PictureFormat,
        Field(
            description="png; npy: numpy's file of a label_map or object_map (uint16), of depth (float32, scene "
            "units), normals (float32, unit length, 0 nothing) or confidence (float32, 0 to 1); jpeg: of rgb, overlay, "
            "relevancy, depth_picture or objects, about a tenth of the bytes and far quicker to make than png, with "
            "small errors in its colors"
        ),
    ] = "png"
    depth_scale: Annotated[
        float, Field(ge=0, description="scene units that one step of a 16-bit depth PNG means; 0: 0.001")
    ] = 0.0
    tints: Annotated[
        Many[Tint],
        Field(
            description="of rgb: colors over objects where the object_map shows them; the last one of an object holds"
        ),
    ] = ()
    dimming: Annotated[
        float, Field(ge=0, le=1, description="of rgb: share of its brightness lost where no tint is")
    ] = 0.0
    coarse: Annotated[bool, Field(description="of rgb: a large scene by fewer Gaussians, quickly, as it moves")] = False


@dataclass(frozen=True)
class PictureRequest(RenderIn, OfScene):
    """One view of one scene as a picture."""
