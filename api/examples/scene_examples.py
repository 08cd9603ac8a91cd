"""Examples of scenes, questions and answers, as values of the contract's types."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from fastsplat.api.examples.change_examples import SCALE, Bodies
from fastsplat.api.examples.example_parameters import IDS, PAGE_TOKEN
from fastsplat_contract.errors import SceneFileError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.object_prompts import ObjectPrompt
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.jobs.job_watching import PlacedCameras, PlacedInfo, Preview, PreviewInfo
from fastsplat_contract.jobs.operations import JobAttempt, JobEstimate, Operation, OperationList, StageProgress
from fastsplat_contract.masks import Segmentation, ViewMask, encode_rle
from fastsplat_contract.messages.contact_sheets import ContactSheet, NeighborObject, SheetObject
from fastsplat_contract.messages.object_reads import ObjectRead
from fastsplat_contract.messages.objects import (
    NameSuggestion,
    ObjectList,
    PickedLevel,
    PickedObject,
    PickIn,
    Pixel,
    PixelBox,
    SceneObject,
)
from fastsplat_contract.messages.phrases import PhraseAnswer, Witness
from fastsplat_contract.messages.queries import Answer, Match, QueryIn, QueryOut, SkippedScene
from fastsplat_contract.messages.scenes import (
    Color,
    DictionaryEntry,
    Edit,
    EditIn,
    LabelList,
    Scene,
    SceneList,
    SceneSummary,
    SceneUpdate,
    SceneVersion,
    UndoIn,
    VersionList,
)
from fastsplat_contract.photos.photo_verdicts import PhotoVerdict, PhotoVerdictList
from fastsplat_contract.photos.pictures import RenderIn, Tint
from fastsplat_contract.photos.scene_photos import BestView, BestViewList, PhotoList, ScenePhoto

_PLACED = PlacedInfo(1, 60, 60, complete=True)

PREVIEW = Preview(PreviewInfo(4, 1_250, 16.5, 24_000, 24.8, "front.png", 320, 240), b"\xff\xd8\xff")
ESTIMATE = JobEstimate(185.4, {"capture": 23.1, "perception": 33.9, "training": 121.5, "export": 6.9})
PLACED = PlacedCameras(
    _PLACED,
    (PosedCamera(Camera(width=64, height=48, fx=60.0, fy=60.0, cx=32.0, cy=24.0), np.eye(4), "front.png"),),
    bytes(12),
    b"\xc8\x96\x64",
)


def running_operation(operation_id: str, scene_id: str, posted: datetime, updated: datetime) -> Operation:
    """Builds a job in the middle of its second stage."""
    return Operation(
        id=operation_id,
        scene_id=scene_id,
        state="RUNNING",
        done=False,
        created_at=posted,
        updated_at=updated,
        stages=(
            StageProgress("capture", 1.0, "60 of 60 images registered", 41.5, {"registered": 60.0}),
            StageProgress("perception", 0.5, "30 of 60 images labelled", 22.0, {}),
        ),
        error=None,
        attempt=1,
        attempts=(JobAttempt(1, "5c1f09ab", posted, None, None),),
        worker="working",
        seconds_left=310.0,
        placed=_PLACED,
    )


_POSTED = datetime(2026, 1, 1, 12, 0, tzinfo=UTC)
_DONE = datetime(2026, 1, 1, 12, 9, tzinfo=UTC)
_UPRIGHT = Quaternion(0.0, 0.0, 0.0, 1.0)
_PINHOLE = Camera(width=64, height=48, fx=60.0, fy=60.0, cx=32.0, cy=24.0)
_VIEWPOINT = PosedCamera(_PINHOLE, np.eye(4))
VIEW = PosedCamera(_PINHOLE, np.eye(4), "front.png")
_MUG = DictionaryEntry(label_id=1, label="mug", aliases=("cup",), pixels=48_210, views=31, gaussian_count=5_120)
_BALL = DictionaryEntry(label_id=2, label="ball", aliases=(), pixels=20_007, views=28, gaussian_count=2_416)
_BOX = Box(center=Pose(Vector3(0.12, 0.05, 0.81), _UPRIGHT), size=Vector3(0.09, 0.11, 0.09))
_OBJECT = SceneObject(
    id=1,
    name="mug",
    source="person",
    probability=1.0,
    suggestions=(),
    kind="object",
    surface="",
    consensus=0.96,
    gaussian_count=5_120,
    box=_BOX,
    meters=True,
    centroid=Vector3(0.12, 0.04, 0.81),
    label_id=1,
)
_SUGGESTED = (NameSuggestion("bottle", 0.4), NameSuggestion("vase", 0.3, IDS["scene_id"]))
_UNNAMED = replace(
    _OBJECT,
    id=2,
    name="",
    label_id=0,
    source=None,
    probability=0.0,
    suggestions=_SUGGESTED,
    reads=(ObjectRead("text", "oat milk", 0.97, 3),),
)
_DAMAGE = SceneFileError("the scene's file labels.npy is damaged", field="scene")
_MASK = np.zeros((48, 64), dtype=np.bool_)
_MASK[20:30, 24:40] = True
_VIEW_MASK = ViewMask(
    view="front.png",
    camera_index=0,
    segmentation=Segmentation((48, 64), encode_rle(_MASK)),
    png=None,
    area=int(_MASK.sum()),
)
OPERATION = running_operation(IDS["operation_id"], IDS["scene_id"], _POSTED, _DONE)
_SUMMARY = SceneSummary(
    id=IDS["scene_id"],
    name="my table",
    state="READY",
    operation_id=IDS["operation_id"],
    created_at=_POSTED,
    gaussians=182_400,
    scale="METRIC",
    version="1",
    label_count=2,
    object_count=7,
    captured_at=_POSTED - timedelta(hours=2),
)
_PHOTO = PhotoVerdict(
    name="IMG_0042.jpg",
    placed=False,
    not_placed="few_matches",
    defects=("blurred",),
    duplicate_of="",
    sharpness=0.31,
    brightness=0.84,
    matches=9,
    advice="It is much less sharp than the others: hold the camera still, or take it again.",
    withheld=0.083,
    between=("IMG_0041.jpg", "IMG_0042.jpg"),
    exposure_ev=-0.42,
    red_ev=0.03,
    blue_ev=-0.05,
)
VERSION = SceneVersion(
    scene_id=IDS["scene_id"],
    version=IDS["version"],
    parent="1",
    created_at=_DONE,
    gaussians=177_280,
    current=True,
    edits=(Edit("remove", label="mug"),),
)
_ANSWER = Answer(
    scene_id=IDS["scene_id"],
    text="cup left of the ball",
    probability=0.97,
    label_set=(1,),
    coverage=0.9,
    version="1",
    gaussians=182_400,
    match_count=2,
    matches=(
        Match(1, "mug", 0.91, 0.88, "object", 5_120, True, 0.96),
        Match(2, "ball", 0.32, 0.41, "objects", 2_416, False, 0.02),
    ),
    masks=(_VIEW_MASK,),
    objects=(replace(_OBJECT, best_views=("front.png",)),),
    presence=0.99,
    phrase=PhraseAnswer(
        asks="objects",
        head="cup",
        conditions=("left of the ball",),
        not_understood="",
        object_ids=(1,),
        undecided=(),
        witnesses=(Witness("left of the ball", 1, (2,), "direction", 12.5, "deg", 5.2),),
    ),
    outcome="here",
    sentence='Here (97 %): "mug" for "cup", left of the ball.',
)
OPERATIONS = OperationList((OPERATION,), PAGE_TOKEN)
SCENE = Scene(
    **vars(_SUMMARY),
    camera_count=1,
    dictionary=(_MUG, _BALL),
    cameras=(VIEW,),
    quality={"psnr": 28.4, "images": 60, "registered": 60},
)
SCENES = SceneList((_SUMMARY,), PAGE_TOKEN)
LABELS = LabelList((_MUG, _BALL), "")
PHOTO_VERDICTS = PhotoVerdictList((_PHOTO,), PAGE_TOKEN, True, placed_count=59, photo_count=60)
OBJECTS = ObjectList((_OBJECT, _UNNAMED), "", "1")
PICKED = PickedObject(_OBJECT, _VIEW_MASK, "1", levels=(PickedLevel("object", _OBJECT.id, (), 1.0),))
PHOTOS = PhotoList((ScenePhoto("front.png", 98_304),), "", "1")
BEST_VIEWS = BestViewList((BestView("front.png", 0.052, False, True, _VIEW_MASK),), "1")
CONTACT_SHEET = ContactSheet(
    b"\xff\xd8\xff",
    (SheetObject(1, _UNNAMED.id, "front.png", True, _BOX.size, "", (NeighborObject(_OBJECT.id, "mug"),), _SUGGESTED),),
    (),
    True,
    "",
    "1",
)
VERSIONS = VersionList((VERSION,))
ANSWERS = QueryOut((_ANSWER,), (SkippedScene(IDS["scene_id"], _DAMAGE.reason, _DAMAGE.message),), 1)

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
    "scale": SCALE,
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
