"""Names that somebody suggests for things of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from fastsplat_contract.wire import Many, Request


@dataclass(frozen=True)
class SuggestedName(Request):
    """A name that somebody suggests for a thing; nothing bears it until a person says so."""

    thing: Annotated[int, Field(description="id of a thing or part")]
    name: Annotated[str, Field(description="one line of 1 to 200 characters")]
    probability: Annotated[float, Field(ge=0, le=1, description="that it is right, as the source says")]
    source: Annotated[str, Field(description="who says so, e.g. an assistant: 1 to 60 characters")]
    model: Annotated[str, Field(description="of the source, for people")] = ""
    aliases: Annotated[Many[str], Field(description="other words for the name")] = ()


@dataclass(frozen=True)
class SuggestIn(Request):
    """Names that somebody suggests for things of a scene."""

    proto: ClassVar[str] = "SuggestNamesRequest"

    suggestions: Annotated[
        Many[SuggestedName],
        Field(
            description="1 to 1,000, at most five of a source for a thing; what a source says of a thing replaces what "
            "it said before"
        ),
    ]
    request_id: Annotated[str, Field(description="same id: the version that it made is returned again (AIP-155)")] = ""
