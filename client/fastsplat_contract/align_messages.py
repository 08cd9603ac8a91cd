"""Putting a scene into the frame of a map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from fastsplat_contract.places import Alignment
from fastsplat_contract.wire import Request


@dataclass(frozen=True)
class AlignIn(Request):
    """A new version of a scene in the frame of a map."""

    proto: ClassVar[str] = "AlignSceneRequest"

    alignment: Alignment
    request_id: Annotated[str, Field(description="same id: the version that it made is returned again (AIP-155)")] = ""
