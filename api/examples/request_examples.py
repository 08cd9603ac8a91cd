"""Examples of what calls are sent: bodies, forms and parameters of the OpenAPI document."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from fastsplat.api.examples.example_parameters import IDS
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.gaussian_filters import GaussianFilter
from fastsplat_contract.geometry.object_prompts import ObjectPrompt, Pixel, PixelBox
from fastsplat_contract.geometry.places import KnownLength, Place
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.jobs.look_again import LookAgainIn
from fastsplat_contract.jobs.name_suggestions import AgreeIn, AskCaptionerIn, SuggestedName, SuggestIn
from fastsplat_contract.jobs.operations import RetryIn
from fastsplat_contract.messages.edit_previews import PreviewEditIn
from fastsplat_contract.messages.measurements import MeasureIn
from fastsplat_contract.messages.objects import PickIn
from fastsplat_contract.messages.projects import CreateProjectRequest
from fastsplat_contract.messages.queries import QueryIn
from fastsplat_contract.messages.scenes import (
    Color,
    Edit,
    EditIn,
    RedoIn,
    RestoreIn,
    SceneUpdate,
    UndoIn,
)
from fastsplat_contract.photos.pictures import RenderIn, Tint
from fastsplat_contract.server.keys import KeyIn, UploadKeyIn

Bodies = Mapping[str, tuple[str, Any]]
"""Bodies of one type by name, each with a summary."""
_KNOWN_LENGTH = KnownLength(
    Place(point=Vector3(0.0, 0.0, 0.0)), Place(point=Vector3(0.5, 0.0, 0.0)), meters=0.25, plus_minus=0.001
)
_SCALE = (
    "make the scene metric by a length between two points",
    EditIn((Edit("scale", known_lengths=(_KNOWN_LENGTH,)),)),
)
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
_UPRIGHT = Quaternion(0.0, 0.0, 0.0, 1.0)
_PINHOLE = Camera(width=64, height=48, fx=60.0, fy=60.0, cx=32.0, cy=24.0)
_VIEWPOINT = PosedCamera(_PINHOLE, np.eye(4))
QUESTIONS: Bodies = {
    "view": (
        "masks in one of the scene's own views, and boxes",
        QueryIn(("cup", "ball"), views=("front.png",), outputs=frozenset({"mask2d", "objects"}), max_matches=5),
    ),
    "viewpoint": (
        "masks seen from a robot's camera",
        QueryIn(("mug",), cameras=(_VIEWPOINT,), outputs=frozenset({"mask2d"}), mask2d_encoding="png"),
    ),
    "relation": (
        "the object left of another, as seen from one of the scene's own views",
        QueryIn(("the mug left of the ball",), outputs=frozenset({"objects"}), asker_view="front.png"),
    ),
    "gaussians": (
        "which Gaussians answer",
        QueryIn(("mug",), outputs=frozenset({"mask3d"}), mask3d_encoding="runs", version="1"),
    ),
}
PICTURES: Bodies = {
    "view": ("the answer drawn over one of the scene's own views", RenderIn("overlay", "mug", view="front.png")),
    "viewpoint": ("depth in millimeters from a robot's camera", RenderIn("depth", camera=_VIEWPOINT)),
    "array": ("label ids as numpy's file", RenderIn("label_map", view="front.png", format="npy")),
    "tinted": (
        "a quick picture in which an object glows",
        RenderIn(
            "rgb", camera=_VIEWPOINT, format="jpeg", tints=(Tint((1,), Color(1.0, 0.56, 0.06), 0.75),), dimming=0.5
        ),
    ),
}
EDITS: Bodies = {
    "recolor": (
        "paint all mugs green",
        EditIn((Edit("recolor", label="mug", color=Color(0.1, 0.8, 0.2)),), "a-name-of-your-choice"),
    ),
    "move": (
        "move all balls half a unit along x",
        EditIn((Edit("move", label="ball", transform=Pose(Vector3(0.5, 0.0, 0.0), _UPRIGHT)),)),
    ),
    "name": ("name an object that had no name, or another", EditIn((Edit("name", object_ids=(2,), name="ball"),))),
    "split": (
        "take two objects apart that were one",
        EditIn(
            (
                Edit("merge", object_ids=(1, 2)),
                Edit("split", object_ids=(1,), prompt=ObjectPrompt(view="front.png", pixels=(Pixel(24.0, 18.0),))),
            )
        ),
    ),
    "add": (
        "make an object that was missing, and name it",
        EditIn(
            (
                Edit("discard", object_ids=(2,)),
                Edit("add", prompt=ObjectPrompt(view="front.png", box=PixelBox(20.0, 13.0, 29.0, 22.0)), name="ball"),
            )
        ),
    ),
    "scale": _SCALE,
    "remove": ("remove one kind of object", EditIn((Edit("remove", label="story book"),))),
}
PLACES: Bodies = {
    "pixel": ("the object at a pixel of a view", PickIn(view="front.png", pixel=Pixel(24.0, 18.0))),
    "box": ("the object that fits a box best", PickIn(view="front.png", box=PixelBox(4.0, 3.0, 44.0, 33.0))),
    "viewpoint": ("the object that a robot's camera has in its middle", PickIn(_VIEWPOINT, pixel=Pixel(32.0, 24.0))),
    "level": (
        "which Gaussians are of the whole object at a pixel",
        PickIn(view="front.png", pixel=Pixel(24.0, 18.0), level="object", mask3d=True),
    ),
}
NAMES: Bodies = {"name": ("only if nobody has renamed it meanwhile", SceneUpdate("my desk", "made"))}
UNDONE: Bodies = {"version": ("only if nobody has edited the scene meanwhile", UndoIn(IDS["version"]))}
FORM: Mapping[str, Any] = {
    "name": "my table",
    "labels": ["mug", "ball", "story book"],
    "uploads": [IDS["upload_id"]],
    "preset": "balanced",
    "time_budget_s": 600.0,
    "max_gaussians": 300_000,
    "priority": 0,
    "request_id": "a-name-of-your-choice",
}
"""Form that posts a capture already sent as a resumable upload."""
AGREEMENTS: Bodies = {
    "yes": ("pictures of objects without a name may go there", AgreeIn("localhost:11434")),
    "no": ("nothing is sent any more", AgreeIn("")),
}
NEW_KEYS: Bodies = {
    "robot": ("a key for a year that only looks", KeyIn("robot in the kitchen", "reader", 31_536_000.0)),
    "person": ("a key that also creates and changes", KeyIn("Ada")),
}
UPLOAD_KEYS: Bodies = {"default": ("a link for one's phone", UploadKeyIn())}
PROJECTS: Bodies = {"kitchen": ("one for the kitchen", CreateProjectRequest("kitchen"))}
_ROUGH = (
    Pose(Vector3(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0)),
    Pose(Vector3(0.5, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0)),
)
LOCALIZE_FORM: Mapping[str, Any] = {
    "photos": ["hall-left.jpg", "hall-right.jpg"],
    "focals": [3024.0],
    "poses": [json.dumps(to_plain(pose)) for pose in _ROUGH],
}
"""Form with two photos (named only) from one camera, half a scene unit apart."""
OBSERVE_FORM: Mapping[str, Any] = {**LOCALIZE_FORM, "seen_at": "2026-11-23T18:00:00+01:00", "request_id": "monday"}
"""Form with two photos of another day."""
