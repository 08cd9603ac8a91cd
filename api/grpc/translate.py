"""Protos to the service's types and back, nothing else. Names that agree are copied field by field of the message."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, TypeVar

from google.protobuf import json_format, struct_pb2, timestamp_pb2
from google.protobuf.message import Message

from fastsplat.api.cameras import WORLD, Convention, orientation_of, posed_camera, position_of, unit_quaternion
from fastsplat.service.calls import types
from fastsplat.service.common.camera import Camera, PosedCamera
from fastsplat.service.common.errors import InvalidInputError
from fastsplat.service.common.states import OperationState
from fastsplat_contract.v1 import fastsplat_pb2 as pb

M = TypeVar("M", bound=Message)
E = TypeVar("E")

_CONVENTIONS: dict[int, Convention] = {
    pb.CONVENTION_UNSPECIFIED: "OPENCV",
    pb.CONVENTION_OPENCV: "OPENCV",
    pb.CONVENTION_OPENGL: "OPENGL",
}
_OUTPUTS: dict[int, types.Output] = {
    pb.OUTPUT_MASK2D: "mask2d",
    pb.OUTPUT_MASK3D: "mask3d",
    pb.OUTPUT_OBJECTS: "objects",
}
_MASK2D: dict[int, types.MaskEncoding] = {
    pb.MASK_ENCODING_UNSPECIFIED: "rle",
    pb.MASK_ENCODING_RLE: "rle",
    pb.MASK_ENCODING_PNG: "png",
}
_MASK3D: dict[int, types.Mask3dEncoding] = {
    pb.MASK3D_ENCODING_UNSPECIFIED: "bits",
    pb.MASK3D_ENCODING_BITS: "bits",
    pb.MASK3D_ENCODING_RUNS: "runs",
    pb.MASK3D_ENCODING_INDICES: "indices",
    pb.MASK3D_ENCODING_PLY: "ply",
}
_KINDS: dict[int, types.PictureKind] = {
    pb.PICTURE_KIND_RGB: "rgb",
    pb.PICTURE_KIND_OVERLAY: "overlay",
    pb.PICTURE_KIND_RELEVANCY: "relevancy",
    pb.PICTURE_KIND_MASK: "mask",
    pb.PICTURE_KIND_LABEL_MAP: "label_map",
    pb.PICTURE_KIND_DEPTH: "depth",
    pb.PICTURE_KIND_DEPTH_PICTURE: "depth_picture",
}
_FORMATS: dict[int, types.PictureFormat] = {
    pb.PICTURE_FORMAT_UNSPECIFIED: "png",
    pb.PICTURE_FORMAT_PNG: "png",
    pb.PICTURE_FORMAT_NPY: "npy",
}
_CAMERA_FORMATS: dict[int, types.CameraFormat] = {
    pb.CAMERA_FORMAT_UNSPECIFIED: "json",
    pb.CAMERA_FORMAT_JSON: "json",
    pb.CAMERA_FORMAT_TRANSFORMS: "transforms",
    pb.CAMERA_FORMAT_COLMAP: "colmap",
}
_ACTIONS: dict[int, types.EditAction] = {
    pb.EDIT_ACTION_RECOLOUR: "recolour",
    pb.EDIT_ACTION_REMOVE: "remove",
    pb.EDIT_ACTION_MOVE: "move",
    pb.EDIT_ACTION_DUPLICATE: "duplicate",
}
_STATES: dict[int, OperationState | None] = {
    pb.OPERATION_STATE_UNSPECIFIED: None,
    pb.OPERATION_STATE_QUEUED: "QUEUED",
    pb.OPERATION_STATE_RUNNING: "RUNNING",
    pb.OPERATION_STATE_SUCCEEDED: "SUCCEEDED",
    pb.OPERATION_STATE_FAILED: "FAILED",
    pb.OPERATION_STATE_CANCELLED: "CANCELLED",
}


def camera_in(camera: pb.PosedCamera, field: str) -> PosedCamera:
    """A viewpoint as the service takes it; `field` names it in errors.

    Raises:
        InvalidInputError: a part is missing, or see `posed_camera`.
    """
    for part in ("intrinsics", "position", "orientation"):
        if not camera.HasField(part):
            raise InvalidInputError(f"{part} is missing", field=f"{field}.{part}")
    intrinsics = camera.intrinsics
    return posed_camera(
        Camera(intrinsics.width, intrinsics.height, intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy),
        _xyz(camera.position),
        _xyzw(camera.orientation),
        convention=_named(_CONVENTIONS, camera.convention, f"{field}.convention"),
        frame_id=camera.frame_id,
        field=field,
    )


def query_in(query: pb.QueryRequest) -> types.QueryRequest:
    """Questions as the service takes them."""
    return types.QueryRequest(
        query.scene_id,
        tuple(query.texts),
        tuple(camera_in(camera, f"cameras[{index}]") for index, camera in enumerate(query.cameras)),
        tuple(query.views),
        frozenset(_named(_OUTPUTS, output, "outputs") for output in query.outputs),
        version=query.version,
        negatives=tuple(query.negatives),
        templates=tuple(query.templates),
        coverage=query.coverage if query.HasField("coverage") else None,
        max_matches=query.max_matches,
        mask2d_encoding=_named(_MASK2D, query.mask2d_encoding, "mask2d_encoding"),
        mask3d_encoding=_named(_MASK3D, query.mask3d_encoding, "mask3d_encoding"),
    )


def picture_in(request: pb.RenderViewRequest) -> dict[str, Any]:
    """The arguments of `SceneService.view_picture`."""
    viewpoint = request.WhichOneof("viewpoint")
    return {
        "scene_id": request.scene_id,
        "text": request.text or None,
        "kind": _named(_KINDS, request.kind, "kind"),
        "camera": camera_in(request.camera, "camera") if viewpoint == "camera" else None,
        "view": request.view if viewpoint == "view" else None,
        "version": request.version,
        "image_format": _named(_FORMATS, request.format, "format"),
        "depth_scale": request.depth_scale,
    }


def camera_format_in(request: pb.DownloadCamerasRequest) -> types.CameraFormat:
    """The format asked for."""
    return _named(_CAMERA_FORMATS, request.format, "format")


def state_in(request: pb.ListOperationsRequest) -> OperationState | None:
    """The state asked for, None for all."""
    return _named(_STATES, request.state, "state")


def edits_in(edits: Sequence[pb.Edit]) -> tuple[types.Edit, ...]:
    """Edits as the service takes them."""
    return tuple(_edit_in(edit, f"edits[{number}]") for number, edit in enumerate(edits))


def camera_out(posed: PosedCamera) -> pb.PosedCamera:
    """A scene's view, or a client's own viewpoint, as a message."""
    return pb.PosedCamera(
        intrinsics=pb.Intrinsics(**vars(posed.camera)),
        position=_vector(position_of(posed)),
        orientation=_quaternion(orientation_of(posed)),
        convention=pb.CONVENTION_OPENCV,
        frame_id=WORLD,
        name=posed.name,
    )


def operation_out(operation: types.Operation) -> pb.Operation:
    """A job as a message."""
    return _filled(
        pb.Operation,
        operation,
        state=pb.OperationState.Value(f"OPERATION_STATE_{operation.state}"),
        created_at=timestamp_of(operation.created_at),
        updated_at=timestamp_of(operation.updated_at),
        stages=[_filled(pb.StageProgress, stage) for stage in operation.stages],
        error=operation.error and _filled(pb.OperationError, operation.error),
    )


def label_out(row: types.DictionaryRow) -> pb.DictionaryEntry:
    """A label of a scene as a message."""
    return _filled(pb.DictionaryEntry, row)


def scene_out(scene: types.SceneInfo, *, full: bool) -> pb.Scene:
    """A scene as a message; a list leaves dictionary, cameras and quality out."""
    quality = json_format.Parse(json.dumps(dict(scene.quality)), struct_pb2.Struct()) if full else None
    return _filled(
        pb.Scene,
        scene,
        state=pb.SceneState.Value(f"SCENE_STATE_{scene.state}"),
        created_at=timestamp_of(scene.created_at),
        scale=pb.Scale.Value(f"SCALE_{scene.scale}"),
        dictionary=[label_out(row) for row in scene.dictionary] if full else (),
        cameras=[camera_out(camera) for camera in scene.cameras] if full else (),
        quality=quality,
    )


def version_out(version: types.SceneVersion) -> pb.SceneVersion:
    """A version as a message."""
    return _filled(
        pb.SceneVersion,
        version,
        created_at=timestamp_of(version.created_at),
        edits=map(_edit_out, version.edits),
    )


def object_out(thing: types.SceneObject) -> pb.SceneObject:
    """A thing as a message."""
    return _filled(
        pb.SceneObject,
        thing,
        centroid=_vector(thing.centroid),
        box=pb.Box(center=_pose(thing.box.center), size=_vector(thing.box.size)),
    )


def match_out(match: Any) -> pb.Match:
    """A dictionary entry held against a question as a message."""
    return _filled(pb.Match, match)


def answer_out(result: types.QueryAnswer) -> pb.Answer:
    """An answer as a message, without its matches."""
    answer = result.answer
    return pb.Answer(
        scene_id=result.scene_id,
        text=answer.text,
        verdict=pb.Verdict.Value(f"VERDICT_{answer.verdict.upper()}"),
        explanation=answer.explanation,
        probability=answer.probability,
        label_set=answer.label_set,
        coverage=answer.coverage,
        decided_by=pb.DecidedBy.Value(f"DECIDED_BY_{answer.decided_by.upper()}"),
        threshold=answer.threshold,
        version=result.version,
        match_count=result.match_count,
        gaussians=result.gaussians,
    )


def timestamp_of(moment: datetime) -> timestamp_pb2.Timestamp:
    """A moment as a message."""
    message = timestamp_pb2.Timestamp()
    message.FromDatetime(moment.astimezone(UTC))
    return message


def _filled(message: type[M], value: Any, **more: Any) -> M:
    """A message whose fields are the attributes of `value` by the same names, but for those in `more`."""
    names = (name for name in message.DESCRIPTOR.fields_by_name if name not in more)
    return message(**{name: getattr(value, name) for name in names}, **more)


def _named(known: Mapping[int, E], value: int, field: str) -> E:
    if value not in known:
        raise InvalidInputError(
            f"{field} of {value} is unknown", field=field, hint="The contract names the values that there are."
        )
    return known[value]


def _edit_in(edit: pb.Edit, field: str) -> types.Edit:
    pose = None
    if edit.HasField("transform"):
        turned = unit_quaternion(_xyzw(edit.transform.orientation), field=f"{field}.transform.orientation")
        pose = types.Pose(_xyz(edit.transform.position), turned)
    target = edit.WhichOneof("target")
    return types.Edit(
        _named(_ACTIONS, edit.action, f"{field}.action"),
        edit.label if target == "label" else None,
        edit.object_id if target == "object_id" else None,
        (edit.colour.r, edit.colour.g, edit.colour.b) if edit.HasField("colour") else None,
        pose,
    )


def _edit_out(edit: types.Edit) -> pb.Edit:
    message = pb.Edit(action=pb.EditAction.Value(f"EDIT_ACTION_{edit.action.upper()}"))
    if edit.label is not None:
        message.label = edit.label
    if edit.object_id is not None:
        message.object_id = edit.object_id
    if edit.colour is not None:
        message.colour.CopyFrom(pb.Colour(**dict(zip("rgb", edit.colour, strict=True))))
    if edit.transform is not None:
        message.transform.CopyFrom(_pose(edit.transform))
    return message


def _pose(pose: types.Pose) -> pb.Pose:
    return pb.Pose(position=_vector(pose.position), orientation=_quaternion(pose.orientation))


def _xyz(vector: pb.Vector3) -> types.Vector:
    return vector.x, vector.y, vector.z


def _xyzw(rotation: pb.Quaternion) -> types.Quaternion:
    return rotation.x, rotation.y, rotation.z, rotation.w


def _vector(values: types.Vector) -> pb.Vector3:
    return pb.Vector3(**dict(zip("xyz", values, strict=True)))


def _quaternion(values: types.Quaternion) -> pb.Quaternion:
    return pb.Quaternion(**dict(zip("xyzw", values, strict=True)))
