"""The REST interface's JSON as the service's own types."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from datetime import datetime
from typing import Any

import numpy as np

from fastsplat.service.calls import types
from fastsplat.service.common.camera import Camera, PosedCamera
from fastsplat.service.common.poses import quaternion_of, rotation_of
from fastsplat.service.query.types import Answer, Match

Json = Mapping[str, Any]


def operation_from(body: Json) -> types.Operation:
    """A job."""
    error = body["error"]
    return types.Operation(
        id=body["id"],
        scene_id=body["scene_id"],
        state=body["state"],
        created_at=datetime.fromisoformat(body["created_at"]),
        updated_at=datetime.fromisoformat(body["updated_at"]),
        stages=tuple(types.StageProgress(**stage) for stage in body["stages"]),
        error=None if error is None else types.OperationError(**error),
    )


def scene_from(body: Json) -> types.SceneInfo:
    """A scene, as listed or in full."""
    return types.SceneInfo(
        id=body["id"],
        name=body["name"],
        state=body["state"],
        operation_id=body["operation_id"],
        created_at=datetime.fromisoformat(body["created_at"]),
        gaussians=body["gaussians"],
        scale=body["scale"],
        dictionary=tuple(label_from(row) for row in body.get("dictionary", ())),
        cameras=tuple(camera_from(camera) for camera in body.get("cameras", ())),
        quality=body.get("quality", {}),
        version=body["version"],
        label_count=body["label_count"],
        camera_count=body.get("camera_count", 0),
    )


def label_from(body: Json) -> types.DictionaryRow:
    """A dictionary entry."""
    return types.DictionaryRow(**{**body, "aliases": tuple(body["aliases"])})


def version_from(body: Json) -> types.SceneVersion:
    """A version of a scene."""
    return types.SceneVersion(
        **{
            **body,
            "created_at": datetime.fromisoformat(body["created_at"]),
            "edits": tuple(_edit_from(edit) for edit in body["edits"]),
        }
    )


def object_from(body: Json) -> types.SceneObject:
    """A thing of a scene."""
    box = types.Box(_pose_from(body["box"]["center"]), _vector(body["box"]["size"]))
    views = tuple(body["best_views"])
    return types.SceneObject(**{**body, "centroid": _vector(body["centroid"]), "box": box, "best_views": views})


def answer_from(body: Json) -> types.QueryAnswer:
    """The answer to one text."""
    answer = Answer(
        text=body["text"],
        verdict=body["verdict"],
        matches=tuple(Match(**match) for match in body["matches"]),
        explanation=body["explanation"],
        probability=body["probability"],
        label_set=tuple(body["label_set"]),
        coverage=body["coverage"],
        decided_by=body["decided_by"],
        threshold=body["threshold"],
    )
    return types.QueryAnswer(
        scene_id=body["scene_id"],
        version=body["version"],
        answer=answer,
        match_count=body["match_count"],
        gaussians=body["gaussians"],
        masks=tuple(_mask_from(mask) for mask in body["masks"]),
        mask3d=base64.b64decode(body["mask3d"] or ""),
        objects=tuple(object_from(thing) for thing in body["objects"] or ()),
    )


def camera_from(body: Json) -> PosedCamera:
    """A scene's own view."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_of(**body["orientation"])
    pose[:3, 3] = _vector(body["position"])
    return PosedCamera(Camera(**body["intrinsics"]), pose, body["name"])


def camera_to(posed: PosedCamera) -> dict[str, Any]:
    """A viewpoint for a request."""
    return {
        "intrinsics": vars(posed.camera),
        "position": dict(zip("xyz", posed.world_from_camera[:3, 3].tolist(), strict=True)),
        "orientation": dict(zip("xyzw", quaternion_of(posed.world_from_camera[:3, :3]), strict=True)),
    }


def edit_to(edit: types.Edit) -> dict[str, Any]:
    """An edit for a request."""
    body: dict[str, Any] = {"action": edit.action, "label": edit.label, "object_id": edit.object_id}
    if edit.colour is not None:
        body["colour"] = dict(zip("rgb", edit.colour, strict=True))
    if edit.transform is not None:
        body["transform"] = {
            "position": dict(zip("xyz", edit.transform.position, strict=True)),
            "orientation": dict(zip("xyzw", edit.transform.orientation, strict=True)),
        }
    return body


def query_to(request: types.QueryRequest) -> dict[str, Any]:
    """The body of a `:query`."""
    return {
        "texts": list(request.texts),
        "cameras": [camera_to(camera) for camera in request.cameras],
        "views": list(request.views),
        "outputs": sorted(request.outputs),
        "version": request.version,
        "negatives": list(request.negatives),
        "templates": list(request.templates),
        "coverage": request.coverage,
        "max_matches": request.max_matches,
        "mask2d_encoding": request.mask2d_encoding,
        "mask3d_encoding": request.mask3d_encoding,
    }


def _mask_from(body: Json) -> types.ViewMask:
    rle = body["segmentation"]
    return types.ViewMask(
        view=body["view"],
        camera_index=body["camera_index"],
        area=body["area"],
        rle=None if rle is None else types.RleMask(rle["size"][0], rle["size"][1], rle["counts"]),
        png=base64.b64decode(body["png"] or ""),
    )


def _edit_from(body: Json) -> types.Edit:
    colour, transform = body["colour"], body["transform"]
    return types.Edit(
        action=body["action"],
        label=body["label"],
        object_id=body["object_id"],
        colour=None if colour is None else (colour["r"], colour["g"], colour["b"]),
        transform=None if transform is None else _pose_from(transform),
    )


def _pose_from(body: Json) -> types.Pose:
    x, y, z, w = (body["orientation"][name] for name in "xyzw")
    return types.Pose(_vector(body["position"]), (x, y, z, w))


def _vector(body: Json) -> types.Vector:
    return body["x"], body["y"], body["z"]
