"""What a job shows of its scene while it makes it: pictures of the training, and cameras as they are placed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Base64, Many, Response, travels
from fastsplat_contract.geometry.camera import PosedCamera

WorkerState = Literal["none", "waiting", "working", "silent"]
"""Who works on a job that is not done."""

DraftStage = Literal["points", "training"]
"""What a draft of a scene is made of."""

Until = Literal["first", "good", "done"]
"""How far a scene is: it has any draft, a draft of its training, or its job has ended."""


@travels(request=False)
class Provisional(NamedTuple):
    """What was answered from: a draft of a scene that is still being made, or whose job ended before it was made."""

    stage: Annotated[
        DraftStage,
        Field(
            description="points: the points of the reconstruction, with what was seen in the first photos; training: "
            "Gaussians of a training under way"
        ),
    ]
    fraction: Annotated[float, Field(description="of the training behind it, 0..1")]


@travels(request=False)
class DraftInfo(NamedTuple):
    """The newest draft of the scene that a job makes: a version that can be looked at, asked and edited."""

    number: Annotated[int, Field(description="counts up with each draft of the job")]
    version: Annotated[str, Field(description="of the scene; edits made on the draft before are in it or in one after")]
    stage: DraftStage
    fraction: Annotated[float, Field(description="of the training behind it, 0..1")]


@dataclass(frozen=True)
class CreateSceneResult(Response):
    """What became of the edits that people made on drafts."""

    carried: Annotated[int, Field(description="versions that hold them again, made of the finished scene")]
    lost: Annotated[Many[str], Field(description="what could not be done again, and why; in words, one each")] = ()


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
