"""What a project knows by name: the objects that people named in its scenes, and what they look like."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Base64, Many, Response, travels
from fastsplat_contract.messages.scenes import NextPageToken

EVERY_NAME = "all"
"""As an id: of every name of the project."""


@dataclass(frozen=True)
class KnownName(Response):
    """A name that a person gave, suggested for objects of other scenes that look like this one or bear its tag."""

    id: Annotated[str, Field(description="to forget it by")]
    name: str
    scene_id: Annotated[str, Field(description="where it was given")]
    version: Annotated[str, Field(description="the scene's current one")]
    object_id: Annotated[int, Field(description="the object of the scene that bears it")]
    named_at: datetime
    picture: Annotated[
        Base64,
        Field(
            description="a small JPEG of the object, from a photo of its scene; empty for what is known by a tag alone"
        ),
    ]


@travels(request=False, proto="ListKnownNamesResponse")
class KnownNameList(NamedTuple):
    """One page of the names that a project knows, newest first."""

    names: Many[KnownName]
    next_page_token: NextPageToken
