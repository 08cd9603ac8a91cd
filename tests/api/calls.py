"""The table of calls that answer once: what each protocol calls it, what it answers, and how the service is asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import grpc
import httpx
from google.protobuf import message_factory

from fastsplat.service.application.service import SceneService
from fastsplat_contract.detection_messages import DetectionList
from fastsplat_contract.errors import FastSplatError
from fastsplat_contract.goal_messages import Goal
from fastsplat_contract.job_watching import PlacedCameras, Preview
from fastsplat_contract.json_codec import from_json, to_plain
from fastsplat_contract.known_names import KnownNameList
from fastsplat_contract.measure_messages import Measurement
from fastsplat_contract.next_photo_messages import NextPhotoList
from fastsplat_contract.operations import Operation, OperationList
from fastsplat_contract.photo_messages import BestViewList, PhotoList
from fastsplat_contract.photo_verdicts import PhotoVerdictList
from fastsplat_contract.proto_codec import from_proto, to_proto
from fastsplat_contract.scenes import LabelList, ObjectList, Scene, SceneList, SceneVersion, VersionList
from fastsplat_contract.server_status import ServerStatus
from fastsplat_contract.thing_messages import PickedThing, ThingList
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.served import Faces, rest_refusal, rpc_refusal

Ids = Mapping[str, str]
Request = Any
"""Fields by name, or a request of the contract."""


class Call(NamedTuple):
    """One call.

    Attributes:
        route: of REST.
        answer: the type; None: bytes, or nothing.
        ask: the service in process.
    """

    route: str
    answer: Any
    ask: Callable[[SceneService, Ids, Request], Any]


class Refused(NamedTuple):
    """An error, in the words that all have for it."""

    reason: str
    detail: str
    details: Mapping[str, str]


def _page(request: Request) -> tuple[int, str]:
    return request.get("page_size", 0), request.get("page_token", "")


def _scene(name: str, answer: Any, ask: Callable[..., Any], method: str = "GET") -> Call:
    """A call about a scene; `ask` takes its id and the request."""
    return Call(f"{method} /v1/scenes/{{scene_id}}{name}", answer, lambda s, ids, r: ask(s, ids["scene_id"], r))


def _job(name: str, answer: Any, ask: Callable[..., Any], method: str = "GET") -> Call:
    return Call(
        f"{method} /v1/operations/{{operation_id}}{name}", answer, lambda s, ids, r: ask(s, ids["operation_id"], r)
    )


CALLS: dict[str, Call] = {
    "GetScene": _scene("", Scene, lambda s, of, r: s.get_scene(of)),
    "ListScenes": Call("GET /v1/scenes", SceneList, lambda s, ids, r: s.list_scenes(*_page(r))),
    "UpdateScene": _scene("", Scene, lambda s, of, r: s.update_scene(of, r), "PATCH"),
    "DeleteScene": _scene("", None, lambda s, of, r: s.delete_scene(of), "DELETE"),
    "ListLabels": _scene("/labels", LabelList, lambda s, of, r: s.list_labels(of, *_page(r))),
    "ListObjects": _scene(
        "/objects",
        ObjectList,
        lambda s, of, r: s.answers.list_objects(of, r.get("version", ""), r.get("label", ""), *_page(r)),
    ),
    "ListThings": _scene(
        "/things",
        ThingList,
        lambda s, of, r: s.answers.list_things(of, r.get("version", ""), *_page(r), r.get("parts", False)),
    ),
    "PickThing": _scene(":pick", PickedThing, lambda s, of, r: s.answers.pick(r), "POST"),
    "MeasureScene": _scene(":measure", Measurement, lambda s, of, r: s.answers.measure(r), "POST"),
    "ListVersions": _scene("/versions", VersionList, lambda s, of, r: VersionList(s.versions.all(of))),
    "ListPhotoVerdicts": _scene(
        "/photo-verdicts", PhotoVerdictList, lambda s, of, r: s.list_photo_verdicts(of, *_page(r))
    ),
    "EditScene": _scene(
        ":edit", SceneVersion, lambda s, of, r: s.versions.edit(of, r.edits, r.request_id, r.version), "POST"
    ),
    "LookAgain": _scene(":lookAgain", Operation, lambda s, of, r: s.look_again(of, r), "POST"),
    "TrainMore": _scene(":trainMore", Operation, lambda s, of, r: s.training.order(of, r), "POST"),
    "UndoEdit": _scene(":undo", SceneVersion, lambda s, of, r: s.versions.undo(of, r.get("version", "")), "POST"),
    "RedoEdit": _scene(":redo", SceneVersion, lambda s, of, r: s.versions.redo(of, r.get("version", "")), "POST"),
    "RestoreVersion": _scene(
        ":restore", SceneVersion, lambda s, of, r: s.versions.restore(of, r["version"], r.get("expected")), "POST"
    ),
    "RenderView": _scene(":render", None, lambda s, of, r: s.answers.picture(r), "POST"),
    "DownloadCameras": _scene("/cameras", None, lambda s, of, r: s.camera_file(of, r.format)),
    "DownloadScenePly": _scene(
        "/scene.ply", None, lambda s, of, r: s.answers.scene_ply(of, r.get("version", ""))[0].read_bytes()
    ),
    "DownloadMaskPly": _scene(
        "/mask.ply", None, lambda s, of, r: s.answers.mask_ply(of, r["text"], r.get("version", ""))
    ),
    "DownloadThingIds": _scene("/things.bin", None, lambda s, of, r: s.answers.thing_ids(of, r.get("version", ""))),
    "ExportScene": _scene("/scene.{format}", None, lambda s, of, r: s.exports.file(r)),
    "ListPhotos": _scene("/photos", PhotoList, lambda s, of, r: s.photos.all(of, r.get("version", ""), *_page(r))),
    "DownloadPhoto": _scene("/photo.jpg", None, lambda s, of, r: s.photos.path(of, r["view"])[0].read_bytes()),
    "ListNextPhotos": _scene(
        "/next-photos", NextPhotoList, lambda s, of, r: s.photos.next_photos(of, r.get("version", ""))
    ),
    "ListBestViews": _scene("/views", BestViewList, lambda s, of, r: s.photos.best_views(of, **r)),
    "GetGoal": _scene("/goal", Goal, lambda s, of, r: s.exports.goal(of, r["thing_id"], r.get("robot_radius", 0.0))),
    "ListDetections": _scene("/detections", DetectionList, lambda s, of, r: s.detections.all(of, **r)),
    "ListOperations": Call(
        "GET /v1/operations", OperationList, lambda s, ids, r: s.list_operations(page_size=r.get("page_size", 0))
    ),
    "GetOperation": _job("", Operation, lambda s, of, r: s.get_operation(of)),
    "WaitOperation": _job(":wait", Operation, lambda s, of, r: s.get_operation(of)),
    "CancelOperation": _job(":cancel", Operation, lambda s, of, r: s.cancel_operation(of), "POST"),
    "RetryOperation": _job(
        ":retry", Operation, lambda s, of, r: s.retry_operation(of, tuple(r.get("exclude", ()))), "POST"
    ),
    "FinishOperation": _job(":finish", Operation, lambda s, of, r: s.jobs.finish(of), "POST"),
    "GetPreview": _job("/preview", Preview, lambda s, of, r: s.jobs.preview(of)),
    "GetPlacedCameras": _job("/cameras", PlacedCameras, lambda s, of, r: s.jobs.placed_cameras(of)),
    "GetServerStatus": Call("GET /v1/server/status", ServerStatus, lambda s, ids, r: s.status("operator", "")),
    "ListKnownNames": Call("GET /v1/known-names", KnownNameList, lambda s, ids, r: s.known_names.list(*_page(r))),
    "DeleteKnownName": Call(
        "DELETE /v1/known-names/{name_id}", None, lambda s, ids, r: s.known_names.forget(ids["name_id"])
    ),
}
ELSEWHERE = {
    *("Query", "StreamQuery", "WatchOperation"),  # answered in pieces
    *("CreateScene", "Localize"),  # sent as forms and in pieces: see test_api_uploads and test_api_localize
    "AlignScene",  # an edit by another name: see test_api_improving
    "DeleteKnownNames",  # asks and answers nothing: see test_api_known_names
    *("CreateKey", "CreateUploadKey", "ListKeys", "RevokeKey", "ExpireKey"),  # see test_api_keys
}
"""The calls that are not in the table, and where they are the same over both protocols."""


def with_ids(ids: Ids, request: Request) -> Request:
    """A request of the contract that names its scene, with the scene."""
    return replace(request, scene_id=ids["scene_id"]) if hasattr(request, "scene_id") else request


def in_process(service: SceneService, name: str, ids: Ids, request: Request) -> Any:
    """What the service answers, or how it refuses."""
    try:
        return CALLS[name].ask(service, ids, request)
    except FastSplatError as error:
        return Refused(error.reason, error.message, error.details())


def over_rest(faces: Faces, name: str, ids: Ids, request: Request) -> Any:
    """The same over HTTP."""
    call = CALLS[name]
    method, template = call.route.split(" ")
    fields = dict(request) if isinstance(request, Mapping) else to_plain(request)
    fields.pop("scene_id", None)
    path = template.format(**ids, format=fields.get("format"))
    if method in ("POST", "PATCH"):
        response = faces.rest.request(method, path, json=fields)
    else:
        named = {"thing" if name == "ExportScene" and key == "things" else key: fields[key] for key in fields}
        given = {key: value for key, value in named.items() if value not in (None, "") and f"{{{key}}}" not in template}
        response = faces.rest.request(method, path, params=given)
    return _read(call, response)


def _read(call: Call, response: httpx.Response) -> Any:
    if not response.is_success:
        refusal = rest_refusal(response)
        return Refused(refusal.reason, refusal.detail, refusal.details)
    if call.answer is not None:
        return from_json(call.answer, response.content)
    return response.content if response.status_code != 204 else None


def over_grpc(faces: Faces, name: str, ids: Ids, request: Request) -> Any:
    """The same over gRPC."""
    kind = CALLS[name].answer
    method = pb.DESCRIPTOR.services_by_name["SceneService"].methods_by_name[name]
    if isinstance(request, Mapping):
        message = message_factory.GetMessageClass(method.input_type)(**ids, **request)
    else:
        message = to_proto(request)
        message.scene_id = ids["scene_id"]
    try:
        answer = getattr(faces.rpc, name)(message, timeout=60)
        if method.server_streaming:
            return b"".join(chunk.data for chunk in answer)
    except grpc.RpcError as error:
        refusal = rpc_refusal(error)
        return Refused(refusal.reason, refusal.detail, refusal.details)
    return from_proto(kind, answer) if kind is not None else None
