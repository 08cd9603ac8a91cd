"""What a project knows by name: the things that people named in its scenes, and what they look like."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, ClassVar, NamedTuple

from pydantic import Field

from fastsplat_contract.scenes import NextPageToken
from fastsplat_contract.wire import Base64, Many, Request, Response, travels


@dataclass(frozen=True)
class KnownName(Response):
    """A name that a person gave, suggested for things of other scenes that look like this one or bear its tag."""

    id: Annotated[str, Field(description="to forget it by")]
    name: str
    scene_id: Annotated[str, Field(description="where it was given")]
    version: Annotated[str, Field(description="the scene's current one")]
    thing_id: Annotated[int, Field(description="the thing of the scene that bears it")]
    named_at: datetime
    picture: Annotated[
        Base64,
        Field(
            description="a small JPEG of the thing, from a photo of its scene; empty for what is known by a tag alone"
        ),
    ]


@travels(request=True)
class PackedName(NamedTuple):
    """A name, and what a thing that bears it looks like."""

    name: Annotated[str, Field(min_length=1, max_length=1_000)]
    appearance: Annotated[
        Base64, Field(description="float16, little-endian: features of length 1; then, if known, three lengths, meters")
    ]


@travels(request=True)
class NamePack(NamedTuple):
    """What a project knows by looks, without pictures and scenes, to be used in another one. As JSON it is a file."""

    license: Annotated[
        str, Field(min_length=1, max_length=20_000, description="under which it may be used: a name or a whole text")
    ]
    model: Annotated[str, Field(max_length=200, description="the detector whose features these are")]
    digest: Annotated[
        str, Field(pattern="^[0-9a-f]{64}$", description="SHA-256 of the detector and of how features are taken of it")
    ]
    names: Annotated[Many[PackedName], Field(min_length=1, max_length=10_000)]


@travels(request=False)
class KnownPack(NamedTuple):
    """A pack that was added to a project."""

    id: Annotated[str, Field(description="to forget it by, as a name")]
    license: str
    model: str
    names: Annotated[int, Field(description="how many it has")]
    added_at: datetime


@travels(request=False)
class KindCheck(NamedTuple):
    """How well one name is known again in scenes that it was not learnt from."""

    name: str
    examples: Annotated[int, Field(description="how often it is known, packs included")]
    borne: Annotated[int, Field(description="things with this name in scenes where another scene or a pack knows it")]
    suggested: Annotated[int, Field(description="named things of any name for which it is suggested")]
    right: Annotated[int, Field(description="those of them that bear it")]


@dataclass(frozen=True)
class KnownNamesCheck(Response):
    """What would be suggested for things that people named, each scene's own names left out in turn."""

    proto: ClassVar[str] = "CheckKnownNamesResponse"

    kinds: Annotated[Many[KindCheck], Field(description="by name")]
    borne: Annotated[int, Field(description="of all kinds")]
    suggested: int
    right: int


@dataclass(frozen=True)
class CheckKnownNamesRequest(Request):
    """What to check."""

    pack: Annotated[
        NamePack | None, Field(description="what is checked as if it had been added; absent: what is known by now")
    ] = None


@dataclass(frozen=True)
class ExportNamePackRequest(Request):
    """What to write into a pack."""

    license: Annotated[str, Field(min_length=1, max_length=20_000, description="as of NamePack")]


@dataclass(frozen=True)
class AddNamePackRequest(Request):
    """What shall be suggested from now on."""

    pack: NamePack


@travels(request=False, proto="ListKnownNamesResponse")
class KnownNameList(NamedTuple):
    """One page of the names that a project knows, newest first."""

    names: Many[KnownName]
    next_page_token: NextPageToken
    packs: Annotated[
        Many[KnownPack], Field(description="all that were added, on the first page; the newest first")
    ] = ()
