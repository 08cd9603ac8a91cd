"""Who may call what: the policy exhaustively in process, over both protocols by samples of all roles."""

from __future__ import annotations

import asyncio
import re
import uuid
from collections.abc import Iterator

import grpc
import pytest

from fastsplat.api.access.authenticator import Authenticator, Credentials
from fastsplat.api.access.policy import RULES, UNMATCHED, is_known_route, rule_of
from fastsplat_contract.call import Rule
from fastsplat_contract.errors import FastSplatError
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.guarded import ROUTES, RPCS, SERVICE, Guarded, about_one, without_ids
from tests.api.served import rest_refusal, rpc_refusal

_ROLES = ("reader", "editor", "admin", "operator")
_APART = ("uploader", "suggester")
_CALLERS = {"none": None, "revoked": None, "stranger": "admin", **{r: r for r in (*_APART, *_ROLES)}}
"""Every caller with the role that its key has."""

_OPEN = {
    *("GET /", "GET /docs", "GET /openapi.json", "MOUNT /docs-files", "MOUNT /web", "GET /livez", "GET /readyz"),
    *(f"/grpc.health.v1.Health/{method}" for method in ("Check", "List", "Watch")),
}
_FOR_ONE_UPLOAD = {
    *("CreateScene", "GetOperation", "WaitOperation", "WatchOperation", "GetServerStatus", "EstimateJob"),
    *("POST /v1/scenes", "GET /v1/operations/{operation_id}", "GET /v1/operations/{operation_id}:wait"),
    *("GET /v1/operations/{operation_id}/events", "GET /v1/server/status", "GET /v1/estimate"),
    *("OPTIONS /v1/uploads", "POST /v1/uploads"),
    *(f"{method} /v1/uploads/{{upload_id}}" for method in ("HEAD", "PATCH", "DELETE")),
}
_FOR_SUGGESTERS = {
    *("GetContactSheet", "SuggestNames", "POST /mcp", "GetServerStatus", "GET /v1/server/status"),
    *("GET /v1/scenes/{scene_id}/objects/sheet", "POST /v1/scenes/{scene_id}/name-suggestions"),
}
_ASKING = {
    *(
        f"POST /v1/scenes/{{scene_id}}:{verb}"
        for verb in ("query", "pick", "render", "measure", "localize", "previewEdit")
    ),
    "POST /mcp",  # asks nothing itself: each tool makes calls that are decided here
}
_LOOKING = re.compile(
    r"(Get|List|Localize|Pick|Preview|Measure|Query|Watch|Render|Download|Stream|Search|Wait|Export|Estimate|Check)"
)


def _least_role(name: str) -> str | None:
    """Names the role that a call should need, from reader (looks) to operator (the server's own)."""
    if name in _OPEN:
        return None
    if name.startswith("/"):
        rpc = name.rpartition("/")[2]
        if rpc == "CreateUploadKey":
            return "editor"
        if "Project" in rpc:
            return "operator"
        if rpc.startswith(("Delete", "Agree")) or rpc.endswith(("Key", "Keys", "Log")):
            return "admin"
        return "reader" if _LOOKING.match(rpc) or rpc == "ServerReflectionInfo" else "editor"
    method, path = name.split(" ")
    if path == "/v1/projects":
        return "operator"
    if (
        path.startswith(("/v1/keys", "/v1/captioner"))
        or path.endswith("/log")
        or (method == "DELETE" and "/uploads" not in path)
    ):
        return "admin"
    if path == "/v1/uploads/{upload_id}":
        return "editor"
    return "reader" if method in ("GET", "OPTIONS") or name in _ASKING else "editor"


def _refusal(rule: Rule, caller: str) -> str | None:
    """Why the policy refuses a caller; None: it does not."""
    role = _CALLERS[caller]
    if rule.role is None:
        return None
    if role is None:
        return "UNAUTHENTICATED"
    enough = role in rule.also if role in _APART else _ROLES.index(role) >= _ROLES.index(rule.role)
    return None if enough else "PERMISSION_DENIED"


def test_every_route_and_rpc_is_decided_and_nothing_else() -> None:
    rpcs = {SERVICE + name for name in RPCS}
    assert not [name for name in ROUTES.keys() | rpcs if not is_known_route(name)], "it is in no table of calls"
    foreign = {name for name in RULES if name.startswith("/grpc.")}
    assert set(RULES) == ROUTES.keys() | rpcs | foreign


def test_each_call_needs_the_role_of_what_it_does() -> None:
    assert {name: rule.role for name, rule in RULES.items()} == {name: _least_role(name) for name in RULES}
    for role, calls in (("uploader", _FOR_ONE_UPLOAD), ("suggester", _FOR_SUGGESTERS)):
        assert {name for name, rule in RULES.items() if role in rule.also} == {
            SERVICE + name if name in RPCS else name for name in calls
        }


def test_what_nobody_decided_needs_an_operator() -> None:
    assert rule_of("GET /new").role == rule_of("/fastsplat.v1.SceneService/New").role == "operator"


@pytest.mark.parametrize("caller", _CALLERS)
def test_every_caller_gets_of_every_call_what_its_rule_says(guarded: Guarded, caller: str) -> None:
    async def refusals() -> dict[str, str | None]:
        authenticator = Authenticator(guarded.service.admin.keys.valid, auth_enabled=True)
        codes: dict[str, str | None] = {}
        for name, rule in (*RULES.items(), ("no route", UNMATCHED), ("not decided", rule_of("not decided"))):
            try:
                principal = await authenticator.authenticate(Credentials(guarded.keys[caller]), rule)
                assert (principal is None) == (rule.role is None)
                assert principal is None or principal.role == _CALLERS[caller]
                codes[name] = None
            except FastSplatError as error:
                codes[name] = error.reason
        return codes

    codes = asyncio.run(refusals())
    assert codes == {
        name: _refusal(RULES.get(name) or (UNMATCHED if name == "no route" else rule_of(name)), caller)
        for name in codes
    }


def _refused(rule: Rule) -> Iterator[str]:
    """Nobody, and the highest role that is not enough."""
    if rule.role is not None:
        yield "none"
        refused = [caller for caller in (*_APART, *_ROLES) if _refusal(rule, caller)]
        yield from refused[-1:]


@pytest.mark.parametrize("route", ROUTES)
def test_a_route_by_samples(guarded: Guarded, route: str) -> None:
    rule = rule_of(route)
    for caller in _refused(rule):
        response = guarded.send(route, caller, guarded.shared)
        assert response.status_code == (401 if caller == "none" else 403), caller
        if response.request.method != "HEAD":  # those have no body
            assert rest_refusal(response).reason == _refusal(rule, caller)
        assert ("www-authenticate" in response.headers) == (caller == "none")
    for caller in rule.also:
        _let_in(guarded, route, rule, caller)
    _let_in(guarded, route, rule, rule.role or "none")
    _assert_nothing_there(guarded, route, rule, "stranger")
    guarded.assert_shared_untouched()


def _let_in(guarded: Guarded, route: str, rule: Rule, caller: str) -> None:
    if caller == "uploader" and re.search("operation_id|upload_id", route):
        _assert_nothing_there(guarded, route, rule, caller)
        return
    response = guarded.send(route, caller, guarded.ids_for(route, fresh=rule.role not in (None, "reader")))
    assert response.status_code not in (401, 403, 404, 405), response.text
    assert "{" not in route or response.status_code != 422, response.text


def _assert_nothing_there(guarded: Guarded, route: str, rule: Rule, caller: str) -> None:
    """What is not the caller's is as if it were not there."""
    if "{" not in route:
        return
    ids = guarded.ids_for(route, fresh=False)
    response = guarded.send(route, caller, ids)
    nothing = guarded.send(route, caller, dict.fromkeys(ids, uuid.uuid4().hex))
    assert response.status_code == nothing.status_code == 404, caller
    if response.request.method != "HEAD":
        assert without_ids(rest_refusal(response).detail) == without_ids(rest_refusal(nothing).detail)


@pytest.mark.parametrize("name", RPCS)
def test_an_rpc_by_samples(guarded: Guarded, name: str) -> None:
    rule = rule_of(SERVICE + name)
    for caller in _refused(rule):
        error = guarded.call(name, caller, guarded.shared)
        assert error is not None and error.code().name == rpc_refusal(error).reason == _refusal(rule, caller), caller
    error = guarded.call(name, str(rule.role), guarded.ids_for(name, fresh=rule.role != "reader"))
    if (
        error is not None
    ):  # nothing to undo, a capture without files, a scene whose z is not up, no captioner, no detector
        expected = dict.fromkeys(("UndoEdit", "RedoEdit", "CreateProject"), "ALREADY_EXISTS")
        expected |= dict.fromkeys(("AskCaptioner", "AgreeToCaptioner"), "FAILED_PRECONDITION")
        assert error.code().name == expected.get(name, "INVALID_ARGUMENT"), name
        assert name in (*expected, "CreateScene", "RestoreVersion", "GetGoal", "ObserveScene")
    if "suggester" in rule.also:
        assert guarded.call(name, "suggester", guarded.ids_for(name, fresh=True)) is None
    if "uploader" in rule.also and not about_one(name):
        error = guarded.call(name, "uploader", guarded.shared)
        assert error is None or (name, error.code().name) == ("CreateScene", "INVALID_ARGUMENT")
    if about_one(name):
        ids = guarded.ids_for(name, fresh=False)
        for caller in ("stranger", "uploader") if "uploader" in rule.also else ("stranger",):
            error, nothing = (guarded.call(name, caller, of) for of in (ids, dict.fromkeys(ids, uuid.uuid4().hex)))
            assert error is not None and nothing is not None, caller
            assert error.code() == nothing.code() == grpc.StatusCode.NOT_FOUND
            assert without_ids(rpc_refusal(error).detail) == without_ids(rpc_refusal(nothing).detail)
    guarded.assert_shared_untouched()


def test_lists_and_questions_to_all_scenes_show_the_callers_project_only(guarded: Guarded) -> None:
    scene_id = guarded.shared["scene_id"]
    all_of_them = {"page_size": 500}
    for caller, sees in (("reader", True), ("operator", True), ("stranger", False)):
        headers, metadata = guarded.header(caller), guarded.metadata(caller)
        rest = guarded.faces.rest
        scenes = {scene["id"] for scene in rest.get("/v1/scenes", params=all_of_them, headers=headers).json()["scenes"]}
        jobs = {
            job["scene_id"]
            for job in rest.get("/v1/operations", params=all_of_them, headers=headers).json()["operations"]
        }
        answers = rest.get("/query", params={"text": "mug"}, headers=headers).json()["answers"]
        assert [scene_id in scenes, scene_id in jobs, bool(answers)] == [sees] * 3
        listed = guarded.faces.rpc.ListScenes(pb.ListScenesRequest(), metadata=metadata).scenes
        jobs_too = guarded.faces.rpc.ListOperations(pb.ListOperationsRequest(), metadata=metadata).operations
        answers_too = list(guarded.faces.rpc.Query(pb.QueryRequest(texts=["mug"]), metadata=metadata))
        assert [bool(listed), bool(jobs_too), bool(answers_too)] == [sees] * 3


def test_an_operator_may_name_a_project_and_nobody_else_may_name_anothers(guarded: Guarded) -> None:
    scene_id = guarded.shared["scene_id"]

    def look(caller: str, project: str) -> int:
        headers = {**guarded.header(caller), "X-Fastsplat-Project": project}
        metadata = (*guarded.metadata(caller), ("x-fastsplat-project", project))
        status = guarded.faces.rest.get(f"/v1/scenes/{scene_id}", headers=headers).status_code
        try:
            guarded.faces.rpc.GetScene(pb.GetSceneRequest(scene_id=scene_id), metadata=metadata)
            code = "OK"
        except grpc.RpcError as error:
            code = error.code().name
        assert code == {200: "OK", 404: "NOT_FOUND"}[status]
        return status

    assert look("operator", "default") == look("admin", "default") == 200
    assert look("operator", "elsewhere") == 404  # there is no such scene there
    assert look("stranger", "default") == look("operator", "nowhere") == look("admin", "elsewhere") == 404
    response = guarded.faces.rest.get(
        "/v1/scenes", headers={**guarded.header("operator"), "X-Fastsplat-Project": "elsewhere"}
    )
    assert response.json()["scenes"] == []
