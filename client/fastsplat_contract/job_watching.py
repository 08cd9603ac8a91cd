"""What a job shows of its scene while it makes it: pictures of the training, and cameras as they are placed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.wire import Base64, Many, Response, travels

WorkerState = Literal["none", "waiting", "working", "silent"]
"""Who works on a job that is not done."""


@travels(request=False)
class PreviewInfo(NamedTuple):
    """The newest small picture of a scene that is being trained: one of its training views, rendered."""

    number: Annotated[int, Field(description="counts up with each new picture of the job")]
    step: Annotated[int, Field(description="optimization steps behind it")]
    seconds: Annotated[float, Field(description="seconds of optimization behind it")]
    gaussians: Annotated[int, Field(description="in the scene by then")]
    psnr: Annotated[float | None, Field(description="dB, as measured last; absent before the first time")]
    view: Annotated[str, Field(description="name of the view")]
    width: Annotated[int, Field(description="pixels")]
    height: Annotated[int, Field(description="pixels")]


@dataclass(frozen=True)
class Preview(Response):
    """A small picture of a scene that is being trained."""

    info: PreviewInfo
    picture: Annotated[Base64, Field(description="JPEG")]


@travels(request=False)
class PlacedInfo(NamedTuple):
    """How many photos have a camera, as far as a job has come."""

    number: Annotated[int, Field(description="counts up with each change")]
    placed: Annotated[int, Field(description="images with a camera")]
    images: Annotated[int, Field(description="images in the upload")]
    complete: Annotated[
        bool,
        Field(
            description="whether no more will be placed; until then the world is another one with each change: axes, "
            "origin and unit are those of the moment"
        ),
    ]


@dataclass(frozen=True)
class PlacedCameras(Response):
    """The cameras that a job has placed so far, and some of the points that it knows."""

    info: PlacedInfo
    cameras: Annotated[Many[PosedCamera], Field(description="at most 1000 of them, evenly chosen")]
    points: Annotated[
        Base64, Field(description="at most 5000 points: x, y, z each, little-endian float32, scene units")
    ]
    colors: Annotated[Base64, Field(description="red, green, blue of each of these points, a byte each")]
