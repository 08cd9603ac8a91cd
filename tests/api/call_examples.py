"""What is sent by each call of the table, to be answered or refused by the same words everywhere."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.gaussian_filters import GaussianFilter
from fastsplat_contract.geometry.object_prompts import ObjectPrompt, Pixel, PixelBox
from fastsplat_contract.geometry.places import Alignment, KnownLength, Place
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.jobs.look_again import LookAgainIn
from fastsplat_contract.jobs.name_suggestions import SuggestedName, SuggestIn
from fastsplat_contract.messages.edit_previews import PreviewEditIn
from fastsplat_contract.messages.exports import ExportRequest
from fastsplat_contract.messages.measurements import MeasureRequest
from fastsplat_contract.messages.objects import PickRequest
from fastsplat_contract.messages.scenes import Color, Edit, EditIn, SceneUpdate
from fastsplat_contract.photos.pictures import PictureRequest, Tint
from tests.api.made_scene import turned

_PIXEL = Pixel(24.0, 18.0)
RED = Color(1.0, 0.0, 0.0)
_FAR = Vector3(90.0, 0.0, 0.0)
_SPLIT = Edit("split", object_ids=(1,), prompt=ObjectPrompt(view="front.png", pixels=(_PIXEL,)))
_NEAR = Box(Pose(Vector3(0.0, 0.0, 4.0), Quaternion(0.0, 0.0, 0.0, 1.0)), Vector3(1.5, 9.0, 9.0))
_CROP = Edit("remove", filter=GaussianFilter(box=_NEAR, outside=True))
_LOOSE = Edit("remove", filter=GaussianFilter(isolation_above=1.2))
UP = Pose(Vector3(0.0, -1.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))


class Example(NamedTuple):
    """What is sent: to which call, about what (see test_api_parity), and the reason and field if it is refused."""

    call: str
    request: Any = MappingProxyType({})
    of: str = "scene"
    refused: tuple[str, str] | None = None


def _bad(call: str, request: Any, field: str, reason: str = "INVALID_INPUT", of: str = "scene") -> Example:
    return Example(call, request, of, (reason, field))


def _render(kind: Any, **more: Any) -> Example:
    return Example("RenderView", PictureRequest("", kind, **{"view": "front.png", **more}))


def _export(name: Any, of: str = "scene", **more: Any) -> Example:
    return Example("ExportScene", ExportRequest("", name, **more), of)


def _camera(**changes: Any) -> PictureRequest:
    return PictureRequest("", "rgb", camera=PosedCamera(replace(turned(0.1).camera, **changes), np.eye(4)))


def _with(camera: PosedCamera) -> tuple[tuple[str, Any, str], ...]:
    """Requests with a camera, and where it is in them."""
    place = Place(camera, pixel=_PIXEL)
    length = Edit("scale", known_lengths=(KnownLength(place, Place(point=_FAR), 90.0),))
    split = replace(_SPLIT, prompt=ObjectPrompt(camera, pixels=(_PIXEL,)))
    return (
        ("RenderView", PictureRequest("", "rgb", camera=camera), "camera"),
        ("PickObject", PickRequest("", camera=camera, pixel=_PIXEL), "camera"),
        ("MeasureScene", MeasureRequest(places=(place,), scene_id=""), "places[0].camera"),
        ("EditScene", EditIn((length,), camera.frame_id), "edits[0].known_lengths[0].first.camera"),
        ("EditScene", EditIn((Edit("merge", object_ids=(1, 2)), split), camera.frame_id), "edits[1].prompt.camera"),
    )


_FRAMED = replace(turned(0.0), world_from_camera=UP.matrix() @ turned(0.0).world_from_camera, frame_id="map")
EXAMPLES = (
    *(Example(call, request, "aligned") for call, request, _ in _with(_FRAMED)),
    *(
        _bad(call, request, f"{field}.frame_id", of="aligned")
        for call, request, field in _with(replace(_FRAMED, frame_id="kitchen"))
    ),
    Example("GetScene"),
    Example("GetScene", of="aligned"),
    *(Example("ListScenes", {"page_size": size}) for size in (0, 1)),
    Example("UpdateScene", SceneUpdate("desk <b>☕</b>"), "own"),
    Example("ListLabels"),
    Example("ListLabels", {"page_size": 2}),
    *(Example("ListObjects", fields) for fields in ({}, {"page_size": 2}, {"parts": True, "version": "1"})),
    *(
        Example("PickObject", PickRequest("", **place))
        for place in (
            {"view": "front.png", "pixel": _PIXEL},
            {"view": "front.png", "pixel": _PIXEL, "mask2d_encoding": "png"},
            {"view": "front.png", "box": PixelBox(20.0, 13.0, 29.0, 22.0), "version": "1"},
            {"camera": turned(0.0), "pixel": _PIXEL},
            {"point": Vector3(0.0, 0.0, 4.0)},
            {"point": Vector3(0.0, 0.0, 4.0), "level": "object", "mask3d": True},
        )
    ),
    *(
        Example("MeasureScene", MeasureRequest(places=places, scene_id=""))
        for places in (
            (Place(object_id=1),),
            (Place(view="front.png", pixel=_PIXEL), Place(object_id=1)),
            (Place(point=Vector3(0.0, 0.0, 0.0)), Place(point=Vector3(0.5, 0.0, 0.0))),
        )
    ),
    *(Example("ListVersions", of=of) for of in ("scene", "edited")),
    Example("EditScene", EditIn((Edit("recolor", label="mug", color=RED),), "recolored"), "own"),
    Example("EditScene", EditIn((Edit("name", object_ids=(1, 2), name="cup", aliases=("pot",)),), "named"), "own"),
    Example("EditScene", EditIn((Edit("move", label="ball", transform=UP), Edit("remove", "mug")), "both"), "own"),
    Example("EditScene", EditIn((Edit("merge", object_ids=(1, 2)), _SPLIT), "split"), "own"),
    Example("EditScene", EditIn((_CROP, _LOOSE), "cropped"), "own"),
    *(Example("PreviewEdit", PreviewEditIn(edits)) for edits in ((_CROP,), (_CROP, _LOOSE, Edit("remove", "mug")))),
    Example("PreviewEdit", PreviewEditIn((Edit("remove", filter=GaussianFilter(isolation_above=1e6)),), "1")),
    Example("SuggestNames", SuggestIn((SuggestedName(1, "beaker", 0.4, "eyes", "v1", ("glass",)),), "told"), "own"),
    Example("LookAgain", LookAgainIn(("toy bulldozer", "trophy"), "again"), "own"),
    Example("EditScene", EditIn((Edit("align", alignment=Alignment("map", UP)),), "aligned"), "own"),
    Example("UndoEdit", {}, "edited"),
    Example("RedoEdit", {"version": "1"}, "undone"),
    Example("RestoreVersion", {"version": "1"}, "edited"),
    *(_render(kind, text="ball") for kind in ("overlay", "relevancy", "mask")),
    *(
        _render(kind)
        for kind in ("rgb", "label_map", "depth_picture", "object_map", "objects", "normals", "confidence")
    ),
    *(_render(kind, format="npy") for kind in ("label_map", "depth", "object_map", "normals", "confidence")),
    _render("depth", depth_scale=0.002),
    _render("rgb", view=None, camera=turned(0.25)),
    _render("rgb", coarse=True, tints=(Tint((1,), RED, 0.5),)),
    *(_render(kind, text="ball", view=None, camera=turned(0.25)) for kind in ("overlay", "relevancy", "mask")),
    _render("rgb", format="jpeg", tints=(Tint((1,), RED, 0.5),), dimming=0.5, version="1"),
    _export("spz", coarse=True),
    *(_export(name, object_ids=(1, 2)) for name in ("ply", "spz", "sog", "mcap", "mesh")),
    *(_export(name) for name in ("ply", "cameras", "points", "spz", "camera_list", "transforms", "objects")),
    _export("points", cell=0.2),
    _export("map", "upright", cell=0.1),
    Example("ListPhotos"),
    Example("ListPhotos", {"page_size": 1, "version": "1"}),
    Example("DownloadPhoto", {"view": "photos/left side & ü.png"}),
    Example("ListNextPhotos"),
    Example("ListObservations", {"version": "1"}),
    _bad("GetObservation", {"observation_id": "e0"}, "observation_id", "NOT_FOUND"),
    *(
        Example("ListBestViews", fields)
        for fields in (
            {"object_ids": (1, 2)},
            {"object_ids": (3,), "max_views": 1},
            {"text": "cup", "max_views": 2},
            {"text": "volcano", "version": "1"},
        )
    ),
    Example("GetContactSheet"),
    Example("GetContactSheet", {"page_size": 1}, "unnamed"),
    Example("GetGoal", {"object_id": 1, "robot_radius": 0.15}, "upright"),
    *(Example("ListDetections", fields, "upright") for fields in ({}, {"page_size": 1})),
    *(Example("ListOperations", {"page_size": size}) for size in (0, 1)),
    *(Example("GetOperation", of=of) for of in ("done", "training")),
    *(Example("WaitOperation", {"timeout_s": 0.0}, of) for of in ("done", "training")),
    Example("FinishOperation", of="training"),
    Example("CancelOperation", of="training"),
    Example("RetryOperation", {"exclude": ("bad.jpg",)}, "cancelled"),
    *(Example(name, of="training") for name in ("GetPreview", "GetPlacedCameras", "GetJobLog")),
    *(Example(name) for name in ("GetServerStatus", "ListProjects")),
    Example("EstimateJob", {"photos": 26, "width": 480, "height": 360, "preset": "draft"}),
    _bad("EstimateJob", {"photos": 1_000_000}, "photos", "LIMIT_EXCEEDED"),
    _bad("CreateProject", {"name": "Kitchen!"}, "project"),
    Example("ListKnownNames", {"page_size": 1}, "named"),
    # What is refused: by each call something that is not there, and every way to say what makes no sense.
    *(
        _bad(name, {}, "scene", "NOT_FOUND", "nothing")
        for name in (
            *("GetScene", "DeleteScene", "ListLabels", "ListObjects", "ListVersions", "ListPhotoVerdicts"),
            *("ExportScene", "ListPhotos", "ListNextPhotos", "ListDetections"),
        )
    ),
    *(_bad(f"{name}Operation", {}, "operation", "NOT_FOUND", "nothing") for name in ("Get", "Cancel", "Retry")),
    *(_bad(name, {}, "operation", "NOT_FOUND", "nothing") for name in ("FinishOperation", "GetPreview")),
    _bad("WaitOperation", {}, "operation", "NOT_FOUND", "nothing"),
    _bad("DeleteKnownName", {}, "name_id", "NOT_FOUND", "nothing"),
    _bad("FinishOperation", {}, "", "NOT_READY", "cancelled"),
    *(_bad(name, {}, "", "NOT_FOUND", "cancelled") for name in ("GetPreview", "GetPlacedCameras", "GetJobLog")),
    *(
        _bad("UpdateScene", SceneUpdate("desk", expected), "scene", "NOT_FOUND", "nothing")
        for expected in (None, "made")
    ),
    _bad("UpdateScene", SceneUpdate("x" * 10_000), "name", "LIMIT_EXCEEDED"),
    *(_bad("UpdateScene", SceneUpdate(name), "name") for name in ("two\nlines", "a\x00b")),
    _bad("UpdateScene", SceneUpdate("table", "another"), "expected_name", "CONFLICT"),
    *(
        _bad("PickObject", PickRequest("", **place), field, reason)
        for place, field, reason in (
            ({"view": "front.png", "pixel": Pixel(48.0, 1.0)}, "pixel", "INVALID_INPUT"),
            ({"view": "front.png", "pixel": Pixel(-0.5, 1.0)}, "pixel", "INVALID_INPUT"),
            ({"view": "front.png", "pixel": Pixel(0.5, 0.5)}, "pixel", "NOT_FOUND"),
            ({"view": "front.png", "box": PixelBox(3.0, 3.0, 3.0, 9.0)}, "box", "INVALID_INPUT"),
            ({"view": "front.png"}, "pixel", "INVALID_INPUT"),
            ({"view": "front.png", "pixel": _PIXEL, "level": "group"}, "level", "NOT_FOUND"),
            ({"pixel": _PIXEL}, "view", "INVALID_INPUT"),
            ({"view": "none.png", "pixel": _PIXEL}, "view", "NOT_FOUND"),
            ({"view": "front.png", "pixel": _PIXEL, "version": "e9"}, "version", "NOT_FOUND"),
            ({"point": _FAR}, "point", "NOT_FOUND"),
        )
    ),
    _bad("MeasureScene", MeasureRequest(places=(), scene_id=""), "places"),
    *(
        _bad("EditScene", EditIn(edits), field, reason)
        for edits, field, reason in (
            ((), "edits", "INVALID_INPUT"),
            ((Edit("remove", label="unicorn"),), "edits[0].label", "NOT_FOUND"),
            ((Edit("recolor", label="mug"),), "edits[0].color", "INVALID_INPUT"),
            ((Edit("name", object_ids=(1,), name="two\nlines"),), "edits[0].name", "INVALID_INPUT"),
            ((replace(_SPLIT, prompt=None),), "edits[0].prompt", "INVALID_INPUT"),
            ((Edit("align", alignment=Alignment("map")),), "edits[0].alignment", "INVALID_INPUT"),
            ((Edit("look_again", texts=("trophy",)),), "edits[0].texts", "INVALID_INPUT"),
        )
    ),
    *(
        _bad(call, kind((Edit("remove", filter=chosen),)), f"edits[0].{field}")
        for call, kind in (("EditScene", EditIn), ("PreviewEdit", PreviewEditIn))
        for chosen, field in (
            (GaussianFilter(), "filter"),
            (GaussianFilter(outside=True, opacity_below=0.5), "filter.outside"),
            (GaussianFilter(box=replace(_NEAR, size=Vector3(1.0, 0.0, 1.0))), "filter.box.size"),
            (GaussianFilter(opacity_below=1.5), "filter.opacity_below"),
            (GaussianFilter(isolation_above=0.0), "filter.isolation_above"),
        )
    ),
    _bad("EditScene", EditIn((Edit("remove", filter=GaussianFilter(isolation_above=1e6)),)), "edits[0].filter"),
    _bad("EditScene", EditIn((Edit("remove", filter=GaussianFilter(opacity_below=1.0)),)), "edits[0].filter"),
    _bad("PreviewEdit", PreviewEditIn(()), "edits"),
    _bad("PreviewEdit", PreviewEditIn((_LOOSE,), "e0"), "version", "NOT_FOUND"),
    _bad("PreviewEdit", PreviewEditIn((Edit("recolor", label="mug", color=RED),)), "edits[0].action"),
    _bad("LookAgain", LookAgainIn(("cup", "cups")), "texts[1]"),
    _bad("AskCaptioner", {}, "captioner", "MODEL_UNAVAILABLE"),  # where it has one: see test_own_captioner
    _bad("AgreeToCaptioner", {"host": "localhost:11434"}, "captioner", "MODEL_UNAVAILABLE"),
    _bad("UndoEdit", {}, "", "CONFLICT"),
    _bad("RedoEdit", {}, "", "CONFLICT"),
    _bad("RestoreVersion", {"version": "e0"}, "version", "NOT_FOUND"),
    *(
        _bad("RenderView", PictureRequest("", **{"view": "front.png", **more}), field)
        for more, field in (
            ({"kind": "depth", "format": "jpeg"}, "format"),
            ({"kind": "object_map", "format": "jpeg"}, "format"),
            ({"kind": "mask", "text": "mug", "format": "jpeg"}, "format"),
            ({"kind": "depth_picture", "format": "npy"}, "format"),
            ({"kind": "objects", "format": "npy"}, "format"),
            ({"kind": "objects", "tints": (Tint((1,), RED, 0.5),)}, "tints"),
            ({"kind": "depth", "dimming": 0.5}, "dimming"),
            ({"kind": "depth", "coarse": True}, "coarse"),
            ({"kind": "mask"}, "text"),
        )
    ),
    *(
        _bad("RenderView", PictureRequest("", "rgb", view="front.png", tints=tints), field, "NOT_FOUND")
        for tints, field in (
            ((Tint((1, 60_000), RED, 0.5),), "tints[0].object_ids[1]"),
            ((Tint((), RED, 0.5), Tint((-1,), RED, 0.5)), "tints[1].object_ids[0]"),
        )
    ),
    _bad("RenderView", PictureRequest("", "rgb", view="none"), "view", "NOT_FOUND"),
    _bad("RenderView", _camera(width=2_000_000_000), "camera.width/height", "LIMIT_EXCEEDED"),
    _bad("ExportScene", ExportRequest("", "colmap"), "format"),  # the name of one has blanks
    *(
        _bad("ExportScene", ExportRequest("", name, object_ids=(4_000,)), "object_ids[0]", "NOT_FOUND")
        for name in ("ply", "sog")
    ),
    _bad("ExportScene", ExportRequest("", "spz", cell=0.2), "cell"),
    _bad("ExportScene", ExportRequest("", "sog", coarse=True), "coarse"),
    _bad("ExportScene", ExportRequest("", "spz", object_ids=(1,), coarse=True), "coarse"),
    _bad("ExportScene", ExportRequest("", "map"), "scene_id"),  # its z is not up
    *(
        _bad("ListBestViews", fields, field, reason)
        for fields, field, reason in (
            ({}, "object_ids", "INVALID_INPUT"),
            ({"object_ids": (1,), "text": "ball"}, "object_ids", "INVALID_INPUT"),
            ({"object_ids": (77,)}, "object_ids[0]", "NOT_FOUND"),
            ({"object_ids": (1,), "max_views": -1}, "max_views", "INVALID_INPUT"),
            ({"object_ids": (1,), "max_views": 17}, "max_views", "LIMIT_EXCEEDED"),
            ({"object_ids": (1,), "version": "none"}, "version", "NOT_FOUND"),
            ({"text": "x" * 2_000}, "text", "LIMIT_EXCEEDED"),
        )
    ),
    _bad("GetGoal", {"object_id": 1}, "scene_id"),  # its z is not up
    _bad("GetGoal", {"object_id": 1}, "scene_id", of="table"),  # its lowest level is a table top
    _bad("GetGoal", {"object_id": 4_000}, "object_id", "NOT_FOUND", "upright"),
    _bad("GetGoal", {"object_id": 1, "robot_radius": 5.0}, "object_id", "NOT_FOUND", "upright"),
    _bad("GetGoal", {"object_id": 1, "robot_radius": -1.0}, "robot_radius", of="upright"),
    *(
        _bad(call, fields, field, reason, of)
        for call, of in (("GetContactSheet", "scene"), ("ListDetections", "upright"))
        for fields, field, reason in (
            ({"version": "9"}, "version", "NOT_FOUND"),
            ({"page_token": "not one of ours"}, "page_token", "INVALID_INPUT"),
            ({"page_size": -1}, "page_size", "INVALID_INPUT"),
        )
    ),
)
BOUNDS_OF_THE_URL = {  # where REST's own parameters are bounded, in other words
    *(("GetGoal", "robot_radius"), ("ListBestViews", "max_views")),
    *((call, "page_size") for call in ("ListDetections", "GetContactSheet")),
}
