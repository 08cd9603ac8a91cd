"""Objects: every physical object and surface of a scene, with or without a name; and which one is at a place."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Base64, Int64, Many, OneOf, Request, Response, travels
from fastsplat_contract.geometry.camera import PosedCamera, ViewName
from fastsplat_contract.geometry.object_prompts import Pixel as Pixel
from fastsplat_contract.geometry.object_prompts import PixelBox as PixelBox
from fastsplat_contract.geometry.poses import Box, Vector3
from fastsplat_contract.jobs.job_watching import Provisional
from fastsplat_contract.masks import MaskEncoding, ViewMask
from fastsplat_contract.messages.object_reads import ObjectRead
from fastsplat_contract.messages.scenes import NextPageToken, OfScene, Version

NameSource = Literal["given", "detected", "person"]
"""Who named an object: label maps that came with the capture, a detector, a person."""

ObjectKind = Literal["object", "surface", "part"]
PickLevel = Literal["part", "object", "group"]
AskedLevel = Literal["likeliest", "part", "object", "group"]


@travels(request=False)
class SuggestionSource(NamedTuple):
    """Who suggests a name for an object."""

    source: Annotated[
        str, Field(description="detector: the scene's own models and likenesses; tag: a printed tag; else who sent it")
    ]
    model: Annotated[str, Field(description="of the source; empty where it named none")]
    probability: Annotated[float, Field(description="0..1, by what people confirmed of this source in this scene")]


@travels(request=False)
class NameSuggestion(NamedTuple):
    """A name that an object may have, which nobody has settled."""

    name: str
    probability: Annotated[float, Field(description="0..1, of all that suggest it together")]
    scene_id: Annotated[
        str,
        Field(
            description="another scene of the project, in which a person named an object so that looks like this one, "
            "or bears its printed tag; empty: the name comes from this scene itself"
        ),
    ] = ""
    aliases: Annotated[Many[str], Field(description="other words for it")] = ()
    said_by: Annotated[Many[SuggestionSource], Field(description="who suggests it, the likeliest first")] = ()


@dataclass(frozen=True)
class SceneObject(Response):
    """One physical object or surface of a scene, or a part of one, with or without a name."""

    id: Annotated[int, Field(description="from 1; the same in all versions of the scene that have the object")]
    name: Annotated[str, Field(description="empty for an object without one; objects of one name have one label")]
    source: Annotated[
        NameSource | None,
        Field(description="who named it: the capture's label maps, a detector, a person; absent without a name"),
    ]
    probability: Annotated[float, Field(description="that the name is right, 0..1; 0 without a name")]
    suggestions: Annotated[Many[NameSuggestion], Field(description="names that nobody has settled, likeliest first")]
    kind: Annotated[
        ObjectKind,
        Field(description="surface: a floor, a wall, the top of a table or the like; part: of another object"),
    ]
    surface: Annotated[
        str,
        Field(description="of a surface: floor, ceiling, wall, horizontal surface, or surface; empty for an object"),
    ]
    consensus: Annotated[float, Field(description="share of the views that see it in which it was proposed, 0..1")]
    gaussian_count: Int64
    box: Annotated[Box | None, Field(description="absent if all its Gaussians are too faint to be seen")]
    meters: Annotated[bool, Field(description="whether lengths are meters")]
    parent: Annotated[int, Field(description="of a part: the object that it is a part of; else 0")] = 0
    parts: Annotated[Many[int], Field(description="ids of its parts, which lists of objects have on request")] = ()
    centroid: Annotated[
        Vector3 | None, Field(description="the mean of its surface, world frame, scene units; absent as `box` is")
    ] = None
    guess: Annotated[
        bool, Field(description="whether the name is a detector's and less probable than 0.95: to be shown as a guess")
    ] = False
    groups: Annotated[
        Many[int],
        Field(
            description="ids of the groups of objects that it is in; where objects are shown or taken away, a group's "
            "id stands for its members"
        ),
    ] = ()
    reads: Annotated[
        Many[ObjectRead], Field(description="what photos show written on it, the surest first, at most 24")
    ] = ()
    last_seen: Annotated[
        datetime | None,
        Field(description="when a photo last showed it, of the capture or of an observation; absent where unknown"),
    ] = None
    missing_since: Annotated[
        datetime | None,
        Field(
            description="when it was first looked for in vain, if it was not found anywhere since; its box is then "
            "where it was. Absent for what is there, or was not looked for"
        ),
    ] = None
    seen_in: Annotated[
        str, Field(description="id of the last observation that says something of it; empty without one")
    ] = ""
    label_id: Annotated[int, Field(description="of the label that is its name; 0 without a name")] = 0
    best_views: Annotated[
        Many[str],
        Field(description="of an answer's objects: at most five of the scene's cameras that see it best, best first"),
    ] = ()


@travels(request=False, proto="ListObjectsResponse")
class ObjectList(NamedTuple):
    """One page of a scene's objects, by id, each followed by its parts if they were asked for."""

    objects: Many[SceneObject]
    next_page_token: NextPageToken
    version: Annotated[str, Field(description="which version was read")]


@dataclass(frozen=True)
class PickIn(Request):
    """Which object is there: at a pixel or in a box of a view, or at a point of the scene."""

    proto: ClassVar[str] = "PickObjectRequest"

    camera: Annotated[PosedCamera | None, OneOf("viewpoint"), Field(description="a free viewpoint")] = None
    view: ViewName = None
    pixel: Annotated[
        Pixel | None, OneOf("place"), Field(description="of the camera or view: the object that it shows")
    ] = None
    box: Annotated[
        PixelBox | None,
        OneOf("place"),
        Field(description="of the camera or view, instead of `pixel`: the object whose mask overlaps it best"),
    ] = None
    point: Annotated[
        Vector3 | None,
        OneOf("place"),
        Field(description="instead of `pixel`, in the world frame: the object at it; then no camera or view is needed"),
    ] = None
    version: Version = ""
    mask2d_encoding: Annotated[
        MaskEncoding, Field(description="rle: COCO run lengths; png: 8-bit gray, 255 inside, 0 outside")
    ] = "rle"
    level: Annotated[
        AskedLevel,
        Field(
            description="what the masks show: the part that is there, the object, the group of objects that it is in, "
            "or what is likeliest meant"
        ),
    ] = "likeliest"
    mask3d: Annotated[bool, Field(description="whether to answer which Gaussians are of it, too")] = False


@dataclass(frozen=True)
class PickRequest(PickIn, OfScene):
    """Which object of one scene is there."""


@travels(request=False)
class PickedLevel(NamedTuple):
    """A part, object or group at a place, and how likely it is the one that is meant."""

    level: PickLevel
    id: Annotated[int, Field(description="of the part, the object or the group")]
    members: Annotated[Many[int], Field(description="ids of the objects of a group")]
    probability: Annotated[float, Field(description="that it is meant, 0..1; those of one place add up to 1")]


@dataclass(frozen=True)
class PickedObject(Response):
    """The object at a place, with its part there and the group that it is in."""

    object: SceneObject
    mask: Annotated[ViewMask | None, Field(description="of `level` in the camera or view; absent without one")]
    version: Annotated[str, Field(description="which version was read")]
    part: Annotated[SceneObject | None, Field(description="of the object, at the place; absent for none")] = None
    levels: Annotated[
        Many[PickedLevel],
        Field(
            description="what is there: the part, if any, the object, the group, if any; a second click takes the next"
        ),
    ] = ()
    level: Annotated[PickLevel, Field(description="which of `levels` was asked for, or is likeliest meant")] = "object"
    mask3d: Annotated[
        Base64 | None,
        Field(
            description="of `level`: one bit per Gaussian in row order, most significant bit first; absent unless "
            "asked for"
        ),
    ] = None
    provisional: Annotated[
        Provisional | None, Field(description="what the version is made of, if it is a draft; absent if it is none")
    ] = None

    @property
    def picked(self) -> PickedLevel:
        """The one of `levels` that was asked for, or is likeliest meant."""
        return next(level for level in self.levels if level.level == self.level)
