"""Where to stand for the next photos of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Many, Response, travels
from fastsplat_contract.geometry.camera import PosedCamera

NextPhotoReason = Literal["gap", "few_directions", "hidden"]


@dataclass(frozen=True)
class NextPhoto(Response):
    """One place to stand at, and what to look at from there."""

    camera: Annotated[PosedCamera, Field(description="where to stand and look; its name is empty")]
    near: Annotated[str, Field(description="the scene's camera that is next to it")]
    reason: Annotated[
        NextPhotoReason,
        Field(
            description="gap: no photo looks from this side of the place; few_directions: surfaces that it would see "
            "were seen from few directions; hidden: what it looks at is behind or in something in every photo, and "
            "objects may be there that are not_seen"
        ),
    ]
    advice: Annotated[str, Field(description="the same in one sentence, in words of the photo next to it")]


@travels(request=False, proto="ListNextPhotosResponse")
class NextPhotoList(NamedTuple):
    """At most three places to stand at for the next photos, the most useful first."""

    photos: Many[NextPhoto]
    version: Annotated[str, Field(description="which version was read")]
