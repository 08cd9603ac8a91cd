"""The service's own types as messages of the gRPC interface, and back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from google.protobuf.message import Message

from fastsplat.service.calls import types
from fastsplat.service.common.camera import PosedCamera
from fastsplat.service.query.types import Answer, Match, Verdict
from fastsplat_client.parse import camera_to
from fastsplat_contract.v1 import fastsplat_pb2 as pb

_VERDICTS: dict[int, Verdict] = {
    pb.VERDICT_EXACT: "exact",
    pb.VERDICT_RELATED: "related",
    pb.VERDICT_ABSENT: "absent",
}


def query_message(request: types.QueryRequest) -> pb.QueryRequest:
    """A question."""
    return pb.QueryRequest(
        scene_id=request.scene_id,
        texts=request.texts,
        cameras=[camera_message(camera) for camera in request.cameras],
        views=request.views,
        outputs=[pb.Output.Value(f"OUTPUT_{output.upper()}") for output in sorted(request.outputs)],
        version=request.version,
        negatives=request.negatives,
        templates=request.templates,
        coverage=request.coverage,
        max_matches=request.max_matches,
        mask2d_encoding=pb.MaskEncoding.Value(f"MASK_ENCODING_{request.mask2d_encoding.upper()}"),
        mask3d_encoding=pb.Mask3dEncoding.Value(f"MASK3D_ENCODING_{request.mask3d_encoding.upper()}"),
    )


def camera_message(posed: PosedCamera) -> pb.PosedCamera:
    """A viewpoint."""
    parts = camera_to(posed)
    return pb.PosedCamera(
        intrinsics=pb.Intrinsics(**parts["intrinsics"]),
        position=pb.Vector3(**parts["position"]),
        orientation=pb.Quaternion(**parts["orientation"]),
    )


def answers_of(responses: Iterable[pb.QueryResponse]) -> Iterator[types.QueryAnswer]:
    """The answers in the messages of a Query."""
    return map(_answer, joined(responses))


def joined(responses: Iterable[pb.QueryResponse]) -> Iterator[pb.QueryResponse]:
    """The messages of a Query put together again, one for each answer."""
    whole: pb.QueryResponse | None = None
    for response in responses:
        if response.HasField("answer"):
            if whole is not None:
                yield whole
            whole = pb.QueryResponse(answer=response.answer)
        assert whole is not None, "the first message of a Query carries an answer"
        whole.answer.matches.extend(response.matches)
        for mask in response.masks:
            if not mask.continues:
                whole.masks.append(mask)
            elif mask.png:
                whole.masks[-1].png += mask.png
            else:
                whole.masks[-1].segmentation.counts += mask.segmentation.counts
        whole.objects.extend(response.objects)
        whole.mask3d += response.mask3d
    if whole is not None:
        yield whole


def object_of(thing: pb.SceneObject) -> types.SceneObject:
    """A thing of a scene."""
    center = thing.box.center
    turned = center.orientation
    return types.SceneObject(
        id=thing.id,
        label_id=thing.label_id,
        label=thing.label,
        score=thing.score,
        centroid=_vector(thing.centroid),
        box=types.Box(
            types.Pose(_vector(center.position), (turned.x, turned.y, turned.z, turned.w)), _vector(thing.box.size)
        ),
        gaussian_count=thing.gaussian_count,
        metres=thing.metres,
        best_views=tuple(thing.best_views),
    )


def _answer(whole: pb.QueryResponse) -> types.QueryAnswer:
    answer = whole.answer
    return types.QueryAnswer(
        scene_id=answer.scene_id,
        version=answer.version,
        answer=Answer(
            text=answer.text,
            verdict=_VERDICTS[answer.verdict],
            matches=tuple(
                Match(**{name: _optional(match, name) for name in Match._fields}) for match in answer.matches
            ),
            explanation=answer.explanation,
            probability=_optional(answer, "probability"),
            label_set=tuple(answer.label_set),
            coverage=_optional(answer, "coverage"),
            decided_by="name" if answer.decided_by == pb.DECIDED_BY_NAME else "score",
            threshold=_optional(answer, "threshold"),
        ),
        match_count=answer.match_count,
        gaussians=answer.gaussians,
        masks=tuple(_mask(mask) for mask in whole.masks),
        mask3d=whole.mask3d,
        objects=tuple(object_of(thing) for thing in whole.objects),
    )


def _mask(mask: pb.ViewMask) -> types.ViewMask:
    found = mask.segmentation
    rle = types.RleMask(found.height, found.width, found.counts) if mask.HasField("segmentation") else None
    return types.ViewMask(mask.view, mask.camera_index, mask.area, rle, mask.png)


def _optional(message: Message, name: str) -> Any:
    """A field's value; None where one that may be absent is."""
    if message.DESCRIPTOR.fields_by_name[name].has_presence and not message.HasField(name):
        return None
    return getattr(message, name)


def _vector(values: pb.Vector3) -> types.Vector:
    return values.x, values.y, values.z
