"""Withdrawing photos from a finished scene: which, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from fastsplat_contract.wire import Many, Request, Response


@dataclass(frozen=True)
class WithdrawPhotosIn(Request):
    """Which photos a scene is to be made anew without."""

    proto: ClassVar[str] = "WithdrawPhotosRequest"

    photos: Annotated[
        Many[str],
        Field(
            description="names of photos, as the scene's cameras have them; at least two others must be left. All "
            "versions that the scene has when the job is done are deleted then: what remains is made of the others"
        ),
    ] = ()
    request_id: Annotated[
        str, Field(description="same id, same order: the first operation is returned again (AIP-155)")
    ] = ""


@dataclass(frozen=True)
class WithdrawPhotosResult(Response):
    """What withdrawing photos has made."""

    version: Annotated[str, Field(description="the version that was trained without the photos")]
    photos: Annotated[Many[str], Field(description="names of the photos that are gone")]
    removed: Annotated[Many[str], Field(description="names of the versions that are gone with them")]
    carried: Annotated[int, Field(description="how many versions hold edits that were made again")]
    lost: Annotated[Many[str], Field(description="what of the edits could not be made again, in words")]
