"""Every call of the contract over both protocols, by every kind of caller: what the policy says is what happens.

The calls are those of the application's routes and of the service's descriptor, so that a new one cannot be left out.
"""

from __future__ import annotations

import re
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import grpc
import httpx
import pytest
from fastapi.routing import iter_route_contexts
from google.protobuf import message_factory

from fastsplat.api.access.policy import RULES, Rule, is_known_route, rule_of
from fastsplat.api.rest.access import route_name
from fastsplat.api.rest.app import create_app
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import Settings
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.made_scene import PLAIN_PNG, add_known_name, add_scene
from tests.api.served import Faces, rest_refusal, rpc_refusal, served
from tests.api.training_job import add_training_job

_SERVICE = "/fastsplat.v1.SceneService/"
_ROUTES = [
    (context, method)
    for context in iter_route_contexts(create_app(None, Settings()).routes)
    for method in sorted(context.methods or {"GET"})
]
_RPCS = [(method.name, method) for method in pb.DESCRIPTOR.services_by_name["SceneService"].methods]

_MAY = {
    "none": (None,),
    "revoked": (None,),
    "uploader": (None, "uploader"),
    "reader": (None, "reader"),
    "editor": (None, "reader", "editor"),
    "admin": (None, "reader", "editor", "admin"),
    "stranger": (None, "reader", "editor", "admin"),  # the admin of another project
    "operator": (None, "reader", "editor", "admin", "operator"),
}

_TUS = {"Tus-Resumable": "1.0.0"}
_MOTION = {"position": {"x": 1, "y": 2, "z": 3}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
_REQUESTS: dict[str, dict[str, Any]] = {
    "POST /v1/scenes/{scene_id}:query": {"json": {"texts": ["mug"]}},
    "POST /v1/scenes/{scene_id}:pick": {"json": {"view": "front.png", "pixel": {"x": 24.0, "y": 18.0}}},
    "POST /v1/scenes/{scene_id}:render": {"json": {"kind": "rgb", "view": "front.png"}},
    "POST /v1/scenes/{scene_id}:lookAgain": {"json": {"texts": ["mug"]}},
    "POST /v1/scenes/{scene_id}:trainMore": {"json": {}},
    "POST /v1/scenes/{scene_id}:align": {"json": {"alignment": {"transform": _MOTION}}},
    "POST /v1/scenes/{scene_id}:edit": {"json": {"edits": [{"action": "remove", "label": "mug"}]}},
    "POST /v1/scenes/{scene_id}:measure": {"json": {"places": [{"thing": 1}]}},
    "POST /v1/scenes/{scene_id}:localize": {"files": [("photos", ("plain.png", PLAIN_PNG))]},
    "POST /v1/scenes/{scene_id}:restore": {"json": {"version": "1"}},
    "PATCH /v1/scenes/{scene_id}": {"json": {"name": "new"}},
    "POST /mcp": {
        "json": {"jsonrpc": "2.0", "id": 1, "method": "tools/list"},
        "headers": {"Accept": "application/json"},
    },
    "POST /v1/upload-keys": {"json": {}},
    "POST /v1/keys": {"json": {"name": "new"}},
    "POST /v1/keys/{key_id}:expire": {"json": {"lifetime_s": 3600}},
    "POST /v1/uploads": {"headers": {**_TUS, "Upload-Length": "3", "Upload-Metadata": "filename YS56aXA="}},
    "HEAD /v1/uploads/{upload_id}": {"headers": _TUS},
    "DELETE /v1/uploads/{upload_id}": {"headers": _TUS},
    "PATCH /v1/uploads/{upload_id}": {
        "headers": {**_TUS, "Content-Type": "application/offset+octet-stream", "Upload-Offset": "0"},
        "content": b"abc",
    },
}
"""What a route needs beside its path to be more than bad input."""

_OF_TRAINING = {
    "FinishOperation",
    "GetPreview",
    "GetPlacedCameras",
    "POST /v1/operations/{operation_id}:finish",
    "GET /v1/operations/{operation_id}/preview",
    "GET /v1/operations/{operation_id}/preview.jpg",
    "GET /v1/operations/{operation_id}/cameras",
}
"""Calls and routes that speak of a job while it trains."""


@dataclass(frozen=True)
class _Place:
    """A server with keys of every kind, and how to make a scene of the default project."""

    faces: Faces
    keys: dict[str, str]
    service: SceneService
    settings: Settings
    shared: dict[str, str]

    def ids_for(self, name: str, *, own: bool) -> dict[str, str]:
        """As `ids`; a call about a job that trains has such a one."""
        ids = self.ids(own=own)
        if name not in _OF_TRAINING:
            return ids
        return {**ids, "operation_id": add_training_job(self.service).operation.id}

    def ids(self, *, own: bool) -> dict[str, str]:
        """The ids of a scene, its operation and an upload; with `own`, of new ones that the call may change."""
        if own or not self.shared:
            scene_id = add_scene(self.service, self.settings)
            made = {
                "scene_id": scene_id,
                "operation_id": self.service.get_scene(scene_id).operation_id,
                "key_id": self.service.admin.keys.create("another", "reader")[0].id,
                "name_id": add_known_name(self.service, scene_id),
                "upload_id": self.service.resumable.create("default", "a.zip", 3).id,
            }
            if own:
                return made
            self.shared.update(made)
        return self.shared

    def header(self, caller: str) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.keys[caller]}"} if self.keys[caller] else {}


@pytest.fixture(scope="module")
def place(api_settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[_Place]:
    settings = api_settings.model_copy(update={"auth": "on", "data_dir": tmp_path_factory.mktemp("matrix")})
    with open_service(settings) as service, served(service, settings) as faces:
        service.admin.projects.create("elsewhere")
        make = service.admin.keys.create
        keys = {role: make(role, role)[1] for role in ("uploader", "reader", "editor", "admin", "operator")}
        revoked, keys["revoked"] = make("revoked", "operator")
        service.admin.keys.revoke(revoked.id)
        keys["stranger"] = make("stranger", "admin", project="elsewhere")[1]
        yield _Place(faces, {**keys, "none": ""}, service, settings, {})


def _refusal(rule: Rule, caller: str) -> str | None:
    """Why the policy refuses a caller; None: it does not."""
    if rule.role in _MAY[caller] or (caller == "uploader" and rule.one_upload):
        return None
    return "PERMISSION_DENIED" if len(_MAY[caller]) > 1 else "UNAUTHENTICATED"


def _changes(rule: Rule) -> bool:
    return rule.role not in (None, "reader")


def test_every_route_and_rpc_is_decided_and_nothing_else() -> None:
    routes = {route_name(context, method) for context, method in _ROUTES}
    rpcs = {_SERVICE + name for name, _ in _RPCS}
    assert not [name for name in routes | rpcs if not is_known_route(name)], "add it to api/access/policy.py"
    foreign = {name for name in RULES if name.startswith("/grpc.")}
    assert set(RULES) == routes | rpcs | foreign


def test_what_changes_something_needs_an_editor_and_what_deletes_it_for_ever_an_admin() -> None:
    asking = (
        "POST /v1/scenes/{scene_id}:query",
        "POST /v1/scenes/{scene_id}:pick",
        "POST /v1/scenes/{scene_id}:render",
        "POST /v1/scenes/{scene_id}:measure",
        "POST /v1/scenes/{scene_id}:localize",
        "POST /mcp",  # asks nothing itself: each tool makes calls that are decided here
    )
    looking = r"(Get|List|Localize|Pick|Measure|Query|Watch|Render|Download|Stream|Search|Wait|Export)"
    for context, method in _ROUTES:
        name = route_name(context, method)
        if method not in ("GET", "HEAD", "OPTIONS") and name not in asking:
            admins = name == "DELETE /v1/scenes/{scene_id}" or "/keys" in name or "/known-names" in name
            assert rule_of(name).role == ("admin" if admins else "editor"), name
    for name, _ in _RPCS:
        if not re.match(looking, name):
            admins = name.startswith("Delete") or (name.endswith("Key") and name != "CreateUploadKey")
            assert rule_of(_SERVICE + name).role == ("admin" if admins else "editor"), name


def test_what_nobody_decided_needs_an_operator() -> None:
    assert rule_of("GET /new").role == rule_of("/fastsplat.v1.SceneService/New").role == "operator"


@pytest.mark.parametrize("caller", _MAY)
@pytest.mark.parametrize(("context", "method"), _ROUTES, ids=lambda value: getattr(value, "path", value))
def test_every_route_by_every_caller(place: _Place, context: Any, method: str, caller: str) -> None:
    name = route_name(context, method)
    rule = rule_of(name)
    ids = place.ids_for(name, own=_changes(rule))

    def ask(by: str, **values: str) -> httpx.Response:
        path = {"/web": "/web/icon.svg", "/docs-files": "/docs-files/swagger-ui.css"}.get(context.path, context.path)
        kind = "label_map" if path.endswith(".npy") else "rgb"
        path = path.format(**values, kind=kind, format="spz")
        request = _REQUESTS.get(name, {})
        headers = {**request.get("headers", {}), **place.header(by)}
        params = {"text": "mug", "view": "front.png"}
        return place.faces.rest.request(method, path, params=params, **{**request, "headers": headers})

    response = ask(caller, **ids)
    reason = _refusal(rule, caller)
    if reason is not None:
        assert response.status_code == {"UNAUTHENTICATED": 401, "PERMISSION_DENIED": 403}[reason]
        if method != "HEAD":  # those have no body
            assert rest_refusal(response).reason == reason
        assert ("www-authenticate" in response.headers) == (response.status_code == 401)
    elif "{" not in context.path:
        assert response.status_code not in (401, 403, 404, 405)
    elif caller == "stranger" or (caller == "uploader" and re.search("operation_id|upload_id", context.path)):
        nothing = ask(caller, **dict.fromkeys(ids, uuid.uuid4().hex))
        assert response.status_code == nothing.status_code == 404
        if method != "HEAD":
            assert _without_ids(rest_refusal(response).detail) == _without_ids(rest_refusal(nothing).detail)
        _assert_untouched(place, ids)
    else:
        assert response.status_code not in (401, 403, 404, 405, 422), response.text


@pytest.mark.parametrize("caller", _MAY)
@pytest.mark.parametrize(("name", "method"), _RPCS, ids=lambda value: value if isinstance(value, str) else "")
def test_every_rpc_by_every_caller(place: _Place, name: str, method: Any, caller: str) -> None:
    rule = rule_of(_SERVICE + name)
    ids = place.ids_for(name, own=_changes(rule))
    error = _call(place, name, method, caller, ids)
    reason = _refusal(rule, caller)
    message = message_factory.GetMessageClass(method.input_type).DESCRIPTOR
    about_one = name == "StreamQuery" or any(field in message.fields_by_name for field in ids)
    about_one = about_one and name != "ListKeys"  # a scene there narrows the list of the caller's own keys
    if reason is not None:
        assert error is not None and error.code().name == rpc_refusal(error).reason == reason
    elif about_one and caller in ("stranger", "uploader") and name != "CreateScene":
        nothing = _call(place, name, method, caller, dict.fromkeys(ids, uuid.uuid4().hex))
        assert error is not None and nothing is not None
        assert error.code() == nothing.code() == grpc.StatusCode.NOT_FOUND
        assert _without_ids(rpc_refusal(error).detail) == _without_ids(rpc_refusal(nothing).detail)
        _assert_untouched(place, ids)
    elif error is not None:  # nothing to undo, a capture without files, a scene whose z is not up
        expected = {"UndoEdit": "ALREADY_EXISTS", "RedoEdit": "ALREADY_EXISTS"}
        assert error.code().name == expected.get(name, "INVALID_ARGUMENT"), name
        assert name in (*expected, "CreateScene", "RestoreVersion", "GetGoal")


def _call(place: _Place, name: str, method: Any, caller: str, ids: dict[str, str]) -> grpc.RpcError | None:
    message = _message(name, message_factory.GetMessageClass(method.input_type), ids)
    call: Callable[..., Any] = getattr(place.faces.rpc, name)
    metadata = tuple((header.lower(), value) for header, value in place.header(caller).items())
    try:
        answer = call(iter([message]) if method.client_streaming else message, metadata=metadata, timeout=30)
        if method.server_streaming:
            list(answer)
    except grpc.RpcError as error:
        return error
    return None


def _message(name: str, kind: Any, ids: dict[str, str]) -> Any:
    query = pb.QueryRequest(scene_id=ids["scene_id"], texts=["mug"])
    if name == "StreamQuery":
        return pb.StreamQueryRequest(question=pb.StandingQuestion(query=query))
    if name == "CreateScene":
        return pb.CreateSceneRequest(header=pb.CreateSceneHeader())
    values: dict[str, Any] = {
        **ids,
        "name": "new",
        "lifetime_s": 3600.0,
        "text": "mug",
        "texts": ["mug"],
        "view": "front.png",
        "kind": pb.PICTURE_KIND_RGB,
        "role": pb.ROLE_READER,  # of a new key: one that shows a scene alone may do no more
    }
    values["photos"] = [PLAIN_PNG]
    values["places"] = [pb.Place(thing=1)]
    values["pixel"] = pb.Pixel(x=24.0, y=18.0)
    motion = pb.Pose(position=pb.Vector3(x=1.0), orientation=pb.Quaternion(w=1.0))
    values["alignment"] = pb.Alignment(transform=motion)
    values["edits"] = [pb.Edit(action=pb.EDIT_ACTION_REMOVE, label="mug")]
    return kind(**{field: value for field, value in values.items() if field in kind.DESCRIPTOR.fields_by_name})


def _without_ids(text: str) -> str:
    return re.sub(r"\b([0-9a-f]{32}|[0-9a-f]{12})(-\d+)?\b", "ID", text)


def _assert_untouched(place: _Place, ids: dict[str, str]) -> None:
    scene = place.service.get_scene(ids["scene_id"])
    assert scene.state == "READY" and scene.version == "1"
    assert place.service._store.keys.find(ids["key_id"]).valid(time.time() + 7200)
    assert place.service.resumable.get("default", ids["upload_id"]).offset == 0


def test_lists_and_questions_to_all_scenes_show_the_callers_project_only(place: _Place) -> None:
    scene_id = place.ids(own=False)["scene_id"]
    all_of_them = {"page_size": 500}
    for caller, sees in (("reader", True), ("operator", True), ("stranger", False)):
        headers = place.header(caller)
        metadata = tuple((name.lower(), value) for name, value in headers.items())
        rest = place.faces.rest
        scenes = {scene["id"] for scene in rest.get("/v1/scenes", params=all_of_them, headers=headers).json()["scenes"]}
        jobs = {
            job["scene_id"]
            for job in rest.get("/v1/operations", params=all_of_them, headers=headers).json()["operations"]
        }
        answers = rest.get("/query", params={"text": "mug"}, headers=headers).json()["answers"]
        assert [scene_id in scenes, scene_id in jobs, bool(answers)] == [sees] * 3
        listed = place.faces.rpc.ListScenes(pb.ListScenesRequest(), metadata=metadata).scenes
        jobs_too = place.faces.rpc.ListOperations(pb.ListOperationsRequest(), metadata=metadata).operations
        answers_too = list(place.faces.rpc.Query(pb.QueryRequest(texts=["mug"]), metadata=metadata))
        assert [bool(listed), bool(jobs_too), bool(answers_too)] == [sees] * 3


def test_an_operator_may_name_a_project_and_nobody_else_may_name_anothers(place: _Place) -> None:
    scene_id = place.ids(own=False)["scene_id"]

    def look(caller: str, project: str) -> int:
        headers = {**place.header(caller), "X-Fastsplat-Project": project}
        metadata = tuple((name.lower(), value) for name, value in headers.items())
        status = place.faces.rest.get(f"/v1/scenes/{scene_id}", headers=headers).status_code
        try:
            place.faces.rpc.GetScene(pb.GetSceneRequest(scene_id=scene_id), metadata=metadata)
            code = "OK"
        except grpc.RpcError as error:
            code = error.code().name
        assert code == {200: "OK", 404: "NOT_FOUND"}[status]
        return status

    assert look("operator", "default") == look("admin", "default") == 200
    assert look("operator", "elsewhere") == 404  # there is no such scene there
    assert look("stranger", "default") == look("operator", "nowhere") == look("admin", "elsewhere") == 404
    made = place.faces.rest.get("/v1/scenes", headers={**place.header("operator"), "X-Fastsplat-Project": "elsewhere"})
    assert made.json()["scenes"] == []
