"""Names that somebody suggests for objects of a scene, and the server's own captioner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from fastsplat_contract.codec.wire import Many, Request, Response


@dataclass(frozen=True)
class SuggestedName(Request):
    """A name that somebody suggests for an object; nothing bears it until a person says so."""

    object_id: Annotated[int, Field(description="id of an object or part")]
    name: Annotated[str, Field(description="one line of 1 to 200 characters")]
    probability: Annotated[float, Field(ge=0, le=1, description="that it is right, as the source says")]
    source: Annotated[str, Field(description="who says so, e.g. an assistant: 1 to 60 characters")]
    model: Annotated[str, Field(description="of the source, for people")] = ""
    aliases: Annotated[Many[str], Field(description="other words for the name")] = ()


@dataclass(frozen=True)
class SuggestIn(Request):
    """Names that somebody suggests for objects of a scene."""

    proto: ClassVar[str] = "SuggestNamesRequest"

    suggestions: Annotated[
        Many[SuggestedName],
        Field(
            description="1 to 1,000, at most five of a source for an object; what a source says of an object replaces "
            "what it said before"
        ),
    ]
    request_id: Annotated[str, Field(description="same id: the version that it made is returned again (AIP-155)")] = ""


@dataclass(frozen=True)
class CaptionerStatus(Response):
    """The captioner that a server's settings name."""

    host: Annotated[
        str, Field(description="where pictures of objects without a name would go: host, and port if given")
    ]
    model: Annotated[str, Field(description="as the host calls it; also the source of what it suggests")]
    agreed: Annotated[bool, Field(description="whether the project agreed to this host; nothing is sent before")]


@dataclass(frozen=True)
class AgreeIn(Request):
    """Whether pictures of a project's objects may go to the server's captioner."""

    proto: ClassVar[str] = "AgreeToCaptionerRequest"

    host: Annotated[
        str,
        Field(description="of the server's captioner, as GetServerStatus tells it; empty: the agreement is taken back"),
    ]


@dataclass(frozen=True)
class AskCaptionerIn(Request):
    """The server's captioner shall say what the objects of a scene are."""

    proto: ClassVar[str] = "AskCaptionerRequest"

    request_id: Annotated[str, Field(description="same id: the first operation is returned again (AIP-155)")] = ""


@dataclass(frozen=True)
class CaptionerResult(Response):
    """What the captioner said of the objects of a scene that had no name."""

    suggested: Annotated[int, Field(description="names that are suggested now, at most one for an object")]
    objects: Annotated[int, Field(description="objects that its pictures showed")]
    refused: Annotated[
        int,
        Field(description="names that were left out: unusable, of no object shown, or the same for too many objects"),
    ]
    problem: Annotated[str, Field(description="why objects were not asked about; empty if all were")]
    version: Annotated[str, Field(description="the scene's current one, which has the suggestions")]
