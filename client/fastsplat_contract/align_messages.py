"""Putting a scene into the frame of another capture of the same place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from fastsplat_contract.wire import Request


@dataclass(frozen=True)
class AlignToIn(Request):
    """A new version of a scene in the frame of another scene of the same place."""

    proto: ClassVar[str] = "AlignToSceneRequest"

    other: Annotated[
        str,
        Field(
            description="id of the other scene, whose units are meters; the frame that both are in then has its "
            "alignment's name, or this id"
        ),
    ] = ""
    request_id: Annotated[str, Field(description="same id: the version that it made is returned again (AIP-155)")] = ""
