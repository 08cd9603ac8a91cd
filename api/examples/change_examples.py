"""Examples of edits, versions, measurements and detections."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np

from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.gaussian_filters import GaussianFilter
from fastsplat_contract.geometry.object_prompts import Pixel
from fastsplat_contract.geometry.places import KnownLength, Place
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.jobs.look_again import LookAgainIn
from fastsplat_contract.jobs.name_suggestions import AskCaptionerIn, SuggestedName, SuggestIn
from fastsplat_contract.jobs.operations import RetryIn
from fastsplat_contract.messages.detections import Detection, DetectionList, Support
from fastsplat_contract.messages.edit_previews import EditPreview, PreviewEditIn
from fastsplat_contract.messages.goals import Goal
from fastsplat_contract.messages.measurements import Length, LocatedPlace, MeasureIn, Measurement
from fastsplat_contract.messages.objects import NameSuggestion
from fastsplat_contract.messages.scenes import Edit, EditIn, RedoIn, RestoreIn
from fastsplat_contract.photos.next_photos import NextPhoto, NextPhotoList

Bodies = Mapping[str, tuple[str, Any]]
"""Bodies of one type by name, each with a summary."""

_KNOWN_LENGTH = KnownLength(
    Place(point=Vector3(0.0, 0.0, 0.0)), Place(point=Vector3(0.5, 0.0, 0.0)), meters=0.25, plus_minus=0.001
)

SCALE = (
    "make the scene metric by a length between two points",
    EditIn((Edit("scale", known_lengths=(_KNOWN_LENGTH,)),)),
)
EDIT_PREVIEW = EditPreview("1", 180, 2, (2,), bytes([0b00100001]) + bytes(22))
_MUG_BOX = Box(Pose(Vector3(0.0, 0.0, 4.0), Quaternion(0.0, 0.0, 0.0, 1.0)), Vector3(9.0, 9.0, 9.0))
PREVIEWED: Bodies = {
    "crop": (
        "keep what lies in a box",
        PreviewEditIn((Edit("remove", filter=GaussianFilter(box=_MUG_BOX, outside=True)),)),
    ),
    "floaters": (
        "hardly opaque Gaussians, then those far from all others",
        PreviewEditIn(
            (
                Edit("remove", filter=GaussianFilter(opacity_below=0.05)),
                Edit("remove", filter=GaussianFilter(isolation_above=4.0)),
            )
        ),
    ),
}
MEASUREMENT = Measurement(
    places=(LocatedPlace(Vector3(0.1, 0.2, 0.3), 0.004, 1), LocatedPlace(Vector3(0.6, 0.2, 0.3), 0.003)),
    distance=Length(0.46, 0.451, 0.469),
    center_distance=Length(0.5, 0.49, 0.51),
    sides=(),
    box=None,
    meters=True,
    version="1",
)

_NEXT_CAMERA = PosedCamera(Camera(64, 48, 60.0, 60.0, 32.0, 24.0), np.eye(4), "")
_NEXT_ADVICE = "Stand left of front.png, and look at the table."
NEXT_PHOTOS = NextPhotoList((NextPhoto(_NEXT_CAMERA, "front.png", "gap", _NEXT_ADVICE),), "1")

GOAL = Goal(
    Pose(Vector3(1.025, 0.475, 0.01), Quaternion(0.0, 0.0, 1.0, 0.0)), 3.141592653589793, 0.42, 0.31, 1, "1", "surface"
)

DETECTIONS = DetectionList(
    (
        Detection(
            object_id=1,
            label="mug",
            source="detected",
            probability=0.93,
            alternatives=(NameSuggestion("cup", 0.05),),
            kind="object",
            box=Box(Pose(Vector3(0.4, 0.1, 0.78), Quaternion(0.0, 0.0, 0.0, 1.0)), Vector3(0.12, 0.08, 0.1)),
            position_covariance=(4e-6, 0.0, 0.0, 0.0, 4e-6, 0.0, 0.0, 0.0, 9e-6),
            rotation_covariance=(3e-5, 0.0, 0.0, 0.0, 3e-5, 0.0, 0.0, 0.0, 0.004),
            covariance_terms=("edges", "membership", "scale"),
            support=Support(2, "table", "on", 3.2),
            views=("front.png", "left.png"),
            proposed_in=("front.png",),
            missed_in=("left.png",),
            consensus=0.5,
            first_seen=datetime(2026, 1, 2, 15, 4, 5, tzinfo=UTC),
            last_seen=datetime(2026, 1, 2, 15, 6, 0, tzinfo=UTC),
        ),
    ),
    "",
    "1",
    "map",
    True,
    Vector3(0.0, 0.0, 1.0),
)

MEASURED: Bodies = {
    "size": ("how large an object is", MeasureIn((Place(object_id=1),))),
    "points": (
        "how far two points are apart",
        MeasureIn((Place(point=Vector3(0.0, 0.0, 0.0)), Place(point=Vector3(0.5, 0.0, 0.0)))),
    ),
    "pixel": (
        "how far an object is from what a view shows at a pixel",
        MeasureIn((Place(view="front.png", pixel=Pixel(24.0, 18.0)), Place(object_id=1))),
    ),
}
SOUGHT: Bodies = {
    "texts": (
        "name what looks like one of these",
        LookAgainIn(("toy bulldozer", "trophy"), "another-name-of-your-choice"),
    )
}
SUGGESTED: Bodies = {
    "an assistant": (
        "what an assistant takes two objects for",
        SuggestIn(
            (
                SuggestedName(2, "mug", 0.9, "assistant", "model-of-your-choice", ("cup",)),
                SuggestedName(3, "ball", 0.6, "assistant", "model-of-your-choice"),
            ),
            "a-name-for-these-suggestions",
        ),
    )
}
CAPTIONER_ASKED: Bodies = {"all": ("about all objects without a name", AskCaptionerIn("a-sixth-name-of-your-choice"))}
REDONE: Bodies = {"version": ("only if nobody has edited the scene meanwhile", RedoIn("1"))}
RETRIED: Bodies = {"exclude": ("without a photo that the error names", RetryIn(("IMG_0012.jpg",)))}
RESTORED: Bodies = {"trained": ("back to the scene as it was trained", RestoreIn("1"))}
