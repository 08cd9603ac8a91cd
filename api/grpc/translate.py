"""Protos to the service's types and back, nothing else."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from typing import Literal

from google.protobuf import json_format, struct_pb2, timestamp_pb2

from api.cameras import WORLD, Convention, orientation_of, posed_camera, position_of
from fastsplat.v1 import fastsplat_pb2 as pb
from service.calls import types
from service.calls.service import PictureKind
from service.common.camera import Camera, PosedCamera
from service.common.errors import InvalidInputError

CHUNK_BYTES = 2**20
"""Size of the pieces of anything that could pass gRPC's 4 MiB."""

_FINAL = ("SUCCEEDED", "FAILED", "CANCELLED")
_CONVENTIONS: dict[int, Convention] = {
    pb.CONVENTION_UNSPECIFIED: "OPENCV",
    pb.CONVENTION_OPENCV: "OPENCV",
    pb.CONVENTION_OPENGL: "OPENGL",
}
_OUTPUTS: dict[int, Literal["mask2d", "mask3d"]] = {pb.OUTPUT_MASK2D: "mask2d", pb.OUTPUT_MASK3D: "mask3d"}
_KINDS: dict[int, PictureKind] = {
    pb.PICTURE_KIND_RGB: "rgb",
    pb.PICTURE_KIND_OVERLAY: "overlay",
    pb.PICTURE_KIND_RELEVANCY: "relevancy",
    pb.PICTURE_KIND_MASK: "mask",
}


def camera_in(camera: pb.PosedCamera, field: str) -> PosedCamera:
    """A viewpoint as the service takes it; `field` names it in errors.

    Raises:
        InvalidInputError: a part is missing, or see `posed_camera`.
    """
    for part in ("intrinsics", "position", "orientation"):
        if not camera.HasField(part):
            raise InvalidInputError(f"{part} is missing", field=f"{field}.{part}")
    if camera.convention not in _CONVENTIONS:
        raise InvalidInputError(f"convention {camera.convention} is unknown", field=f"{field}.convention")
    intrinsics, position, orientation = camera.intrinsics, camera.position, camera.orientation
    return posed_camera(
        Camera(intrinsics.width, intrinsics.height, intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy),
        (position.x, position.y, position.z),
        (orientation.x, orientation.y, orientation.z, orientation.w),
        convention=_CONVENTIONS[camera.convention],
        frame_id=camera.frame_id,
        field=field,
    )


def query_in(query: pb.QueryRequest) -> types.QueryRequest:
    """Questions as the service takes them."""
    for output in query.outputs:
        if output not in _OUTPUTS:
            raise InvalidInputError(f"output {output} is unknown", field="outputs", hint="Use MASK2D or MASK3D.")
    cameras = tuple(camera_in(camera, f"cameras[{index}]") for index, camera in enumerate(query.cameras))
    outputs = frozenset(_OUTPUTS[output] for output in query.outputs)
    return types.QueryRequest(query.scene_id, tuple(query.texts), cameras, tuple(query.views), outputs)


def picture_in(request: pb.RenderViewRequest) -> tuple[PictureKind, PosedCamera | None, str | None]:
    """Kind and viewpoint of a picture: a camera, or a view's name."""
    if request.kind not in _KINDS:
        raise InvalidInputError(
            f"picture kind {request.kind} is unknown", field="kind", hint="Use RGB, OVERLAY, RELEVANCY or MASK."
        )
    viewpoint = request.WhichOneof("viewpoint")
    camera = camera_in(request.camera, "camera") if viewpoint == "camera" else None
    return _KINDS[request.kind], camera, request.view if viewpoint == "view" else None


def camera_out(posed: PosedCamera) -> pb.PosedCamera:
    """A scene's view, or a client's own viewpoint, as a message."""
    x, y, z = position_of(posed)
    qx, qy, qz, qw = orientation_of(posed)
    camera = posed.camera
    return pb.PosedCamera(
        intrinsics=pb.Intrinsics(
            width=camera.width, height=camera.height, fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy
        ),
        position=pb.Vector3(x=x, y=y, z=z),
        orientation=pb.Quaternion(x=qx, y=qy, z=qz, w=qw),
        convention=pb.CONVENTION_OPENCV,
        frame_id=WORLD,
        name=posed.name,
    )


def operation_out(operation: types.Operation) -> pb.Operation:
    """A job as a message."""
    error = operation.error
    return pb.Operation(
        id=operation.id,
        scene_id=operation.scene_id,
        state=pb.OperationState.Value(f"OPERATION_STATE_{operation.state}"),
        done=operation.state in _FINAL,
        created_at=_timestamp(operation.created_at),
        updated_at=_timestamp(operation.updated_at),
        stages=[
            pb.StageProgress(
                stage=stage.stage,
                fraction=stage.fraction,
                message=stage.message,
                seconds=stage.seconds,
                metrics=stage.metrics,
            )
            for stage in operation.stages
        ],
        error=None
        if error is None
        else pb.OperationError(
            kind=error.kind, reason=error.reason, message=error.message, stage=error.stage, details=error.details
        ),
    )


def scene_out(scene: types.SceneInfo, *, full: bool) -> pb.Scene:
    """A scene as a message; a list leaves dictionary, cameras and quality out."""
    message = pb.Scene(
        id=scene.id,
        name=scene.name,
        state=pb.SceneState.Value(f"SCENE_STATE_{scene.state}"),
        operation_id=scene.operation_id,
        created_at=_timestamp(scene.created_at),
        gaussians=scene.gaussians,
        scale=pb.Scale.Value(f"SCALE_{scene.scale}"),
    )
    if full:
        message.dictionary.extend(
            pb.DictionaryEntry(
                label_id=row.label_id,
                label=row.label,
                aliases=row.aliases,
                pixels=row.pixels,
                views=row.views,
                gaussian_count=row.gaussian_count,
            )
            for row in scene.dictionary
        )
        message.cameras.extend(camera_out(camera) for camera in scene.cameras)
        message.quality.CopyFrom(json_format.Parse(json.dumps(dict(scene.quality)), struct_pb2.Struct()))
    return message


def answer_out(result: types.QueryAnswer) -> Iterator[pb.QueryResponse]:
    """One answer as one or several messages, each well below gRPC's limit."""
    answer = result.answer
    response = pb.QueryResponse(
        answer=pb.Answer(
            scene_id=result.scene_id,
            text=answer.text,
            verdict=pb.Verdict.Value(f"VERDICT_{answer.verdict.upper()}"),
            explanation=answer.explanation,
            matches=[
                pb.Match(
                    label_id=match.label_id,
                    label=match.label,
                    relevancy=match.relevancy,
                    similarity=match.similarity,
                    nearest_negative=match.nearest_negative,
                    gaussian_count=match.gaussian_count,
                    relevant=match.relevant,
                )
                for match in answer.matches
            ],
        )
    )
    room = CHUNK_BYTES
    for piece in _mask_pieces(result.masks):
        size = len(piece.segmentation.counts) + 256
        if size > room:
            yield response
            response, room = pb.QueryResponse(), CHUNK_BYTES
        response.masks.append(piece)
        room -= size
    for chunk in chunks(result.mask3d):
        if len(chunk) > room:
            yield response
            response, room = pb.QueryResponse(), CHUNK_BYTES
        response.mask3d = chunk
        room = 0
    yield response


def joined(responses: Iterable[pb.QueryResponse]) -> Iterator[pb.QueryResponse]:
    """For clients: the messages of a Query put together again, one for each answer."""
    whole: pb.QueryResponse | None = None
    for response in responses:
        if response.HasField("answer"):
            if whole is not None:
                yield whole
            whole = pb.QueryResponse(answer=response.answer)
        assert whole is not None, "the first message of a Query carries an answer"
        for mask in response.masks:
            if mask.continues:
                whole.masks[-1].segmentation.counts += mask.segmentation.counts
            else:
                whole.masks.append(mask)
        whole.mask3d += response.mask3d
    if whole is not None:
        yield whole


def chunks(data: bytes) -> Iterator[bytes]:
    """`data` in pieces of `CHUNK_BYTES`; none for no data."""
    for start in range(0, len(data), CHUNK_BYTES):
        yield data[start : start + CHUNK_BYTES]


def _mask_pieces(masks: Sequence[types.ViewMask]) -> Iterator[pb.ViewMask]:
    piece_chars = CHUNK_BYTES - 1024
    for mask in masks:
        counts = mask.rle.counts
        yield pb.ViewMask(
            view=mask.view,
            camera_index=mask.camera_index,
            segmentation=pb.RleMask(height=mask.rle.height, width=mask.rle.width, counts=counts[:piece_chars]),
            area=mask.pixels,
        )
        for start in range(piece_chars, len(counts), piece_chars):
            rest = pb.RleMask(counts=counts[start : start + piece_chars])
            yield pb.ViewMask(segmentation=rest, continues=True)


def _timestamp(moment: datetime) -> timestamp_pb2.Timestamp:
    message = timestamp_pb2.Timestamp()
    message.FromDatetime(moment.astimezone(UTC))
    return message
