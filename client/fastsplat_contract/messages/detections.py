"""What a robot needs to know of each object: where it is and how sure that is, what it may be, what carries it, and by
which views it is known. The fields are those of vision_msgs/Detection3DArray, and what that has no room for."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from fastsplat_contract.codec.wire import Many, Response, travels
from fastsplat_contract.geometry.poses import Box, Vector3
from fastsplat_contract.messages.objects import NameSource, NameSuggestion, ObjectKind
from fastsplat_contract.messages.scenes import NextPageToken

SupportRelation = Literal["on", "in"]
"""How an object is carried: it rests on the other or hangs on it, or it is in it."""

CovarianceTerm = Literal["edges", "membership", "scale", "alignment"]
"""What a covariance of positions is made of."""


@travels(request=False)
class Support(NamedTuple):
    """What carries an object."""

    object_id: int
    label: Annotated[str, Field(description="its name; empty for an object without one")]
    relation: Annotated[SupportRelation, Field(description="on: it rests or hangs on it; in: it is in it")]
    clearness: Annotated[float, Field(description="how clear that is: from 1 on it holds, see Witness")]


@dataclass(frozen=True)
class Detection(Response):
    """One object as a robot needs it, as in vision_msgs/Detection3D. What is not known is absent or empty."""

    object_id: Annotated[int, Field(description="from 1; the same in all versions of the scene that have the object")]
    label: Annotated[str, Field(description="its name; empty for an object without one")]
    source: Annotated[NameSource | None, Field(description="who named it; absent without a name")]
    probability: Annotated[float | None, Field(description="that the label is right, 0..1; absent without a name")]
    alternatives: Annotated[
        Many[NameSuggestion],
        Field(description="other names that it may have, which nobody has settled, likeliest first"),
    ]
    kind: ObjectKind
    box: Annotated[
        Box | None,
        Field(
            description="its pose and size in `frame_id`; of its axes the x axis is the longer one across, and which "
            "of its ends is the front is not known; absent if all its Gaussians are too faint to be seen"
        ),
    ]
    position_covariance: Annotated[
        Many[float],
        Field(description="3 by 3, row by row, of the box's middle, in `frame_id`; units squared; empty without a box"),
    ]
    rotation_covariance: Annotated[
        Many[float],
        Field(
            description="3 by 3, row by row, of small rotations of the box about the axes of `frame_id`, radians "
            "squared; empty where its heading cannot be said, as of round objects, or nothing tells what is up"
        ),
    ]
    covariance_terms: Annotated[
        Many[CovarianceTerm],
        Field(
            description="what is in `position_covariance`; what is not named was not known. edges: how sharp the "
            "object's ends are; membership: which of its Gaussians may not be its own; scale: how long a unit is; "
            "alignment: how well the pairs of points fit that put the scene into a map"
        ),
    ]
    support: Annotated[
        Support | None,
        Field(description="what carries it; absent where that is not clear, or nothing tells what is up"),
    ]
    views: Annotated[
        Many[str], Field(description="names of the scene's cameras that see it, the one that shows most of it first")
    ]
    proposed_in: Annotated[
        Many[str],
        Field(
            description="names of the cameras in which it was proposed as an object when it was discovered; empty "
            "where the scene does not keep that"
        ),
    ]
    missed_in: Annotated[
        Many[str],
        Field(
            description="what speaks against it: names of the cameras that saw most of it then, and in which it was "
            "not proposed; empty for none, and where the scene does not keep that"
        ),
    ]
    consensus: Annotated[
        float | None,
        Field(
            description="share of the views that see it in which it was proposed, 0..1; 1 for an object that somebody "
            "added; absent for a scene that stores no objects"
        ),
    ]
    first_seen: Annotated[
        datetime | None,
        Field(
            description="when the first photo of `views` was taken; absent where no photo says when and in which zone"
        ),
    ]
    last_seen: Annotated[datetime | None, Field(description="when the last one was taken; absent as `first_seen`")]

    def covariance(self) -> NDArray[np.float64]:
        """float64 [6, 6] of x, y, z and of rotations about x, y, z, as in geometry_msgs/PoseWithCovariance; NaN where
        it is not known. Position and rotation are taken as independent."""
        whole = np.zeros((6, 6))
        for rows, values in ((slice(0, 3), self.position_covariance), (slice(3, 6), self.rotation_covariance)):
            whole[rows, rows] = np.array(values).reshape(3, 3) if values else np.nan
        return whole


@travels(request=False, proto="ListDetectionsResponse")
class DetectionList(NamedTuple):
    """One page of a scene's objects as a robot needs them, by id."""

    detections: Many[Detection]
    next_page_token: NextPageToken
    version: Annotated[str, Field(description="which version was read")]
    frame_id: Annotated[
        str,
        Field(
            description="the frame of all positions: the map's that the scene was put into (map if that has no name), "
            "or world, as cameras say"
        ),
    ]
    meters: Annotated[bool, Field(description="whether lengths are meters; else only ratios of lengths mean anything")]
    up: Annotated[
        Vector3 | None,
        Field(
            description="the unit vector up in `frame_id`; absent where nothing tells, and then boxes lie along the "
            "principal axes of objects"
        ),
    ]
