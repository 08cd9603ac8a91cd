"""Photos that find their place in a finished scene: where they were taken, what they show, what has changed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Base64, Many, Request, Response, travels
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.object_prompts import PixelBox
from fastsplat_contract.geometry.poses import Box, Pose
from fastsplat_contract.messages.scenes import OfScene, Version

LocalizeRefusal = Literal["no_keypoints", "few_matches", "narrow", "looks_different"]
FocalSource = Literal["given", "metadata", "scene", "estimated"]
DifferenceKind = Literal["new", "missing", "changed"]
ChangeKind = Literal["gone", "moved", "new", "changed"]


@dataclass(frozen=True)
class LocalizeRequest(Request, OfScene):
    """Photos whose place in a scene is asked for."""

    photos: Annotated[
        Many[Base64], Field(description="image files, as for a capture: JPEG, PNG, WebP, TIFF, BMP or HEIC")
    ]
    focals: Annotated[
        Many[float],
        Field(
            description="focal length of each photo, pixels of the upright photo as sent; one number is that of all; "
            "empty: by the photo's metadata, the scene's own photos, or estimated"
        ),
    ] = ()
    poses: Annotated[
        Many[Pose],
        Field(
            description="roughly where each photo was taken, in any one frame, scene units, OpenCV camera axes: the "
            "photos then find their place together; empty: each by itself"
        ),
    ] = ()
    version: Version = ""


@travels(request=False)
class ObjectInView(NamedTuple):
    """An object that is seen from a photo's place."""

    object_id: int
    name: Annotated[str, Field(description="empty for an object without one")]
    share: Annotated[float, Field(description="of the picture's pixels that show it, 0..1")]
    box: Annotated[PixelBox, Field(description="around it, in pixels of the photo")]


@travels(request=False)
class PhotoDifference(NamedTuple):
    """A region in which a photo shows a change that another photo of the request agrees on."""

    kind: Annotated[
        DifferenceKind,
        Field(
            description="new: only the photo has something there; missing: only the scene has; changed: both have, but "
            "another"
        ),
    ]
    box: Annotated[PixelBox, Field(description="in pixels of the photo")]
    strength: Annotated[float, Field(description="the probability of the change, 0..1")]


@dataclass(frozen=True)
class LocalizedPhoto(Response):
    """What became of one photo."""

    refusal: Annotated[
        LocalizeRefusal | None,
        Field(
            description="why no pose is said: too little detail in the photo; too few places of it found in the scene; "
            "these close together in the photo; or the scene looks different from there. Absent where there is a pose"
        ),
    ]
    explanation: Annotated[str, Field(description="the same in one sentence")]
    camera: Annotated[
        PosedCamera | None,
        Field(
            description="where the photo was taken, with the intrinsics of the upright, undistorted photo in its own "
            "size; absent without"
        ),
    ]
    radial: Annotated[
        float,
        Field(description="k1 of the photo's lens, as OpenCV's, by which it was undistorted; 0 where none was found"),
    ]
    covariance: Annotated[
        Many[float],
        Field(
            description="36 numbers, row by row, as geometry_msgs/PoseWithCovariance: x, y, z of the camera's center "
            "in scene units, then small rotations about the world's x, y, z in radians; empty without a pose"
        ),
    ]
    focal_source: Annotated[
        FocalSource | None,
        Field(
            description="what said the focal length: the request, the photo's metadata, the scene's own photos, or the "
            "matches themselves; absent without a pose"
        ),
    ]
    inliers: Annotated[
        int, Field(description="places of the photo that were found in the scene where the pose has them")
    ]
    inlier_share: Annotated[float, Field(description="of the places that were found at all, 0..1")]
    spread: Annotated[float, Field(description="share of the picture inside their convex hull, 0..1")]
    agreement: Annotated[
        float | None,
        Field(
            description="how like the scene's picture from there is to the photo, -1..1; absent where it was not "
            "compared"
        ),
    ]
    refined: Annotated[bool, Field(description="whether comparing the two pictures has made the pose better")]
    objects: Annotated[Many[ObjectInView], Field(description="seen from there, those with most pixels first")]
    differences: Annotated[
        Many[PhotoDifference], Field(description="the changes of the answer that this photo shows, where it shows them")
    ]


@travels(request=False)
class SceneChange(NamedTuple):
    """What is not as it was when the scene was made; at least two photos agree on it."""

    kind: Annotated[
        ChangeKind,
        Field(
            description="gone: an object is not where it was; moved: it is somewhere else now; new: something stands "
            "where nothing stood; changed: something else stands where the object was"
        ),
    ]
    object_id: Annotated[
        int, Field(description="which object of the scene; 0 for what is none of its objects, as what is new")
    ]
    name: Annotated[str, Field(description="of the object; empty without one, or for what is no object of the scene")]
    probability: Annotated[float, Field(description="that this changed, 0..1")]
    distance: Annotated[float, Field(description="how far it moved, scene units; 0 for what did not")]
    before: Annotated[Box | None, Field(description="where it was; absent for what is new")]
    after: Annotated[Box | None, Field(description="where it is; absent for what is gone")]
    photos: Annotated[Many[int], Field(description="numbers of the photos that agree, from 0")]
    sentence: Annotated[str, Field(description="the same in words")]


@dataclass(frozen=True)
class Localization(Response):
    """Where photos were taken."""

    photos: Annotated[Many[LocalizedPhoto], Field(description="in the order of the request")]
    changes: Annotated[
        Many[SceneChange],
        Field(description="since the scene was made, the surest first; of two photos with a place at least"),
    ]
    looked_at: Annotated[
        Many[int],
        Field(description="ids of the objects that two photos should show: of the others these photos say nothing"),
    ]
    meters: Annotated[bool, Field(description="whether a scene unit is a meter")]
    version: Annotated[str, Field(description="which version was read")]
