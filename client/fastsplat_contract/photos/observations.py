"""Observations: what photos of another day say of a finished scene, kept with it."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import RFC_3339, Base64, Many, Request, Response, travels
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import Pose
from fastsplat_contract.messages.requests import InPages, OfVersion
from fastsplat_contract.messages.scenes import NextPageToken, OfScene
from fastsplat_contract.photos.localization import PhotoDifference, SceneChange

SeenAtSource = Literal["given", "metadata", "received"]


@dataclass(frozen=True)
class ObserveRequest(Request, OfScene):
    """Photos of another day, to be kept as what was seen then."""

    proto: ClassVar[str] = "ObserveSceneRequest"

    photos: Annotated[
        Many[Base64],
        Field(description="image files, as for a capture: JPEG, PNG, WebP, TIFF, BMP or HEIC; two at least"),
    ]
    focals: Annotated[Many[float], Field(description="see LocalizeRequest")] = ()
    poses: Annotated[Many[Pose], Field(description="see LocalizeRequest")] = ()
    seen_at: Annotated[
        datetime | None,
        Field(description="when they were taken; absent: by their metadata, or when they came"),
        RFC_3339,
    ] = None
    request_id: Annotated[
        str, Field(description="same id: the observation that it made is returned again (AIP-155)")
    ] = ""


@travels(request=False)
class ObservedPhoto(NamedTuple):
    """A photo of an observation."""

    view: Annotated[
        str,
        Field(
            description="its name for DownloadPhoto; empty where it was not kept: where the server keeps no photos, or "
            "people were to be left out of the scene's own"
        ),
    ]
    camera: Annotated[PosedCamera, Field(description="where it was taken, of the upright, undistorted photo as sent")]
    differences: Annotated[Many[PhotoDifference], Field(description="the changes that it shows, where it shows them")]


@dataclass(frozen=True)
class Observation(Response):
    """What photos of another day say of a scene. It made a version of the scene, and is undone as any version is."""

    scene_id: str
    id: Annotated[str, Field(description="the name of the version that it made")]
    seen_at: Annotated[datetime, Field(description="when its photos were taken")]
    seen_at_source: Annotated[
        SeenAtSource,
        Field(description="given: by who sent them; metadata: the newest of the photos' own; received: when they came"),
    ]
    photos: Annotated[Many[ObservedPhoto], Field(description="those that found their place")]
    left_out: Annotated[Many[str], Field(description="why each other photo of the request is not among them")]
    changes: Annotated[Many[SceneChange], Field(description="against the scene as it was made, the surest first")]
    looked_at: Annotated[
        Many[int], Field(description="ids of the objects that two photos should show: of the others it says nothing")
    ]
    meters: Annotated[bool, Field(description="whether a scene unit is a meter")]
    sentence: Annotated[str, Field(description="what has changed, in words")]


@travels(request=False, proto="ListObservationsResponse")
class ObservationList(NamedTuple):
    """One page of a scene's observations, the newest photos first."""

    observations: Many[Observation]
    next_page_token: NextPageToken
    version: Annotated[str, Field(description="which version was read")]


@dataclass(frozen=True)
class ListObservationsRequest(Request, InPages, OfVersion):
    """Which page of a scene's observations."""


@dataclass(frozen=True)
class GetObservationRequest(Request, OfVersion):
    """Which observation."""

    observation_id: Annotated[str, Field(description="which observation")] = ""
