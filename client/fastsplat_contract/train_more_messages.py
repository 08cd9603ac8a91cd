"""Training a finished scene further: for how long, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from fastsplat_contract.wire import Int64, Many, Request, Response

PresetName = Literal["draft", "balanced", "best"]


@dataclass(frozen=True)
class TrainMoreIn(Request):
    """How much longer a scene is trained, for seconds, for steps, or as long as the preset says; on which photos."""

    proto: ClassVar[str] = "TrainMoreRequest"

    seconds: Annotated[float | None, Field(gt=0, description="of optimization")] = None
    steps: Annotated[int | None, Field(ge=1, description="of optimization, instead of seconds")] = None
    preset: Annotated[
        PresetName | None,
        Field(
            description="size of the pictures and number of Gaussians, and where neither seconds nor steps are said "
            "the time: draft, balanced or best; absent: the server's default"
        ),
    ] = None
    observations: Annotated[
        Many[str],
        Field(
            description="ids of observations of the scene whose photos join its own: what they show is trained, "
            "Gaussians are made where the scene had nothing, and all else stays as it is, to the bit; with neither "
            "seconds nor steps as many steps as their number needs; empty: all is trained, on the photos it has"
        ),
    ] = ()
    request_id: Annotated[
        str, Field(description="same id, same order: the first operation is returned again (AIP-155)")
    ] = ""


@dataclass(frozen=True)
class TrainMoreResult(Response):
    """What training a scene further has made."""

    version: Annotated[str, Field(description="the version that it made")]
    trained_from: Annotated[str, Field(description="the version whose Gaussians it began with")]
    current: Annotated[
        bool,
        Field(
            description="whether it is the scene's current version; not where what is seen was edited meanwhile, by "
            "edits that stay in force: then the new version stands beside them, to be restored"
        ),
    ]
    steps: Annotated[Int64, Field(description="of optimization")]
    seconds: Annotated[float, Field(description="of optimization")]
    gaussians_before: Annotated[Int64, Field(description="of the version that it began with")]
    gaussians: Annotated[Int64, Field(description="of the new version")]
    psnr_before: Annotated[
        float | None, Field(description="dB, of photos that training does not see; absent where all are trained on")
    ]
    psnr: Annotated[float | None, Field(description="dB, of the same photos in the new version")]
    joined: Annotated[Many[str], Field(description="names of the cameras whose photos have joined the scene's")] = ()
    left_out: Annotated[Many[str], Field(description="why other photos of the same observations have not")] = ()
    unchanged: Annotated[
        Int64 | None,
        Field(description="how many Gaussians of before are the same to the bit; absent where no photo has joined"),
    ] = None
