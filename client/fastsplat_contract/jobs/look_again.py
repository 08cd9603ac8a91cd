"""Looking again at a finished scene: what it is searched for, and what that found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Many, Request, Response, travels


@dataclass(frozen=True)
class LookAgainIn(Request):
    """What a scene is searched for once more."""

    proto: ClassVar[str] = "LookAgainRequest"

    texts: Annotated[
        Many[str], Field(description="what to look for, in plain words: at least one, each one line and only once")
    ]
    request_id: Annotated[
        str, Field(description="same id, same texts: the first operation is returned again (AIP-155)")
    ] = ""


@travels(request=False)
class FoundName(NamedTuple):
    """A text that was found at an object."""

    object_id: Annotated[int, Field(description="see SceneObject")]
    name: str
    probability: Annotated[float, Field(description="that the object is that, 0..1")]


@dataclass(frozen=True)
class LookAgainResult(Response):
    """What looking again has found and changed. Names that people or label maps gave stay as they are."""

    version: Annotated[str, Field(description="the version that it made")]
    texts: Annotated[Many[str], Field(description="what was looked for")]
    views: Annotated[Many[str], Field(description="the scene's cameras from which was looked")]
    rendered: Annotated[bool, Field(description="whether renderings of the scene were looked at, not photos")]
    named: Annotated[Many[FoundName], Field(description="objects whose name is one of the texts by this")]
    suggested: Annotated[
        Many[FoundName],
        Field(description="texts that are among the suggestions of an object: not sure enough for a name"),
    ]
    regions: Annotated[int, Field(description="how often any of the texts was found, over all views")]
    unmatched: Annotated[int, Field(description="how many of these are no object of the scene; none is added for them")]
