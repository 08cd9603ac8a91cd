"""Who gets in: every route and every RPC, with no key, a wrong one, one that reads and one that writes."""

from __future__ import annotations

import asyncio
import json
import re
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import grpc
import httpx
import pytest
from fastapi.routing import iter_route_contexts
from google.protobuf import descriptor_pool, message_factory
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection_pb2, reflection_pb2_grpc

from fastsplat.api.auth import _RULES, check_exposure, decided, rule_of
from fastsplat.api.rest.access import AccessLayer, route_name
from fastsplat.api.rest.app import create_app
from fastsplat.api.server import run
from fastsplat.cli.logs import JsonLines
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.served import Faces, rest_refusal, rpc_refusal, served

_ROUTES = [
    (context, method)
    for context in iter_route_contexts(create_app(None, Settings()).routes)
    for method in sorted(context.methods or {"GET"})
]
_RPCS = [(method.name, method) for method in pb.DESCRIPTOR.services_by_name["SceneService"].methods]
_SERVICE = "/fastsplat.v1.SceneService/"
_KEYS = ("none", "wrong", "read", "write")


@pytest.fixture(scope="module")
def locked_settings(api_settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Settings:
    return api_settings.model_copy(update={"auth": "on", "data_dir": tmp_path_factory.mktemp("locked")})


@pytest.fixture(scope="module")
def locked_service(locked_settings: Settings) -> Iterator[SceneService]:
    with open_service(locked_settings) as opened:
        yield opened


@pytest.fixture(scope="module")
def locked(locked_service: SceneService, locked_settings: Settings) -> Iterator[Faces]:
    with served(locked_service, locked_settings) as faces:
        yield faces


@pytest.fixture(scope="module")
def keys(locked_service: SceneService) -> dict[str, str]:
    _, read = locked_service.admin.keys.create("r", "read")
    record, write = locked_service.admin.keys.create("w", "write")
    return {"none": "", "wrong": f"fsk_{record.id}_" + "x" * 43, "read": read, "write": write}


def _expected(need: str, kind: str) -> int | None:
    """The status of a refusal; None: it gets in."""
    if need == "open" or kind == "write":
        return None
    if kind in ("none", "wrong"):
        return 401
    return 403 if need == "write" else None


def _header(key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"} if key else {}


def test_every_route_and_rpc_is_decided_and_nothing_else() -> None:
    routes = {route_name(context, method) for context, method in _ROUTES}
    rpcs = {_SERVICE + name for name, _ in _RPCS}
    assert not [name for name in routes | rpcs if not decided(name)], "add it to the table in api/auth.py"
    foreign = {name for name in _RULES if name.startswith("/grpc.")}
    assert set(_RULES) == routes | rpcs | foreign


def test_what_changes_something_needs_a_key_that_writes() -> None:
    asking = ("POST /v1/scenes/{scene_id}:query", "POST /v1/scenes/{scene_id}:render")
    for context, method in _ROUTES:
        name = route_name(context, method)
        if method not in ("GET", "HEAD", "OPTIONS") and name not in asking:
            assert rule_of(name).need == "write", name
    for name, _ in _RPCS:
        if not re.match(r"(Get|List|Query|Watch|Render|Download|Stream|Search|Wait|Export)", name):
            assert rule_of(_SERVICE + name).need == "write", name


def test_what_nobody_decided_needs_a_key_that_writes() -> None:
    assert rule_of("GET /new").need == rule_of("/fastsplat.v1.SceneService/New").need == "write"


@pytest.mark.parametrize("kind", _KEYS)
@pytest.mark.parametrize(("context", "method"), _ROUTES, ids=lambda value: getattr(value, "path", value))
def test_every_route_with_every_kind_of_key(
    locked: Faces, keys: dict[str, str], context: Any, method: str, kind: str
) -> None:
    path = re.sub(r"\{kind\}", "rgb", context.path)
    path = re.sub(r"\{\w+\}", "x", path)
    if path in ("/web", "/docs-files"):
        path = {"/web": "/web/app.js", "/docs-files": "/docs-files/swagger-ui.css"}[path]
    response = locked.rest.request(method, path, headers=_header(keys[kind]))
    expected = _expected(rule_of(route_name(context, method)).need, kind)
    if expected is None:
        assert response.status_code not in (401, 403), response.text
        return
    assert response.status_code == expected
    if method != "HEAD":  # those have no body
        assert rest_refusal(response).reason == {401: "UNAUTHENTICATED", 403: "PERMISSION_DENIED"}[expected]
    assert ("www-authenticate" in response.headers) == (expected == 401)


@pytest.mark.parametrize("kind", _KEYS)
@pytest.mark.parametrize(("name", "method"), _RPCS, ids=lambda value: value if isinstance(value, str) else "")
def test_every_rpc_with_every_kind_of_key(
    locked: Faces, keys: dict[str, str], name: str, method: Any, kind: str
) -> None:
    code = _call(locked.channel, _SERVICE + name, method, keys[kind])
    expected = {401: "UNAUTHENTICATED", 403: "PERMISSION_DENIED", None: None}[
        _expected(rule_of(_SERVICE + name).need, kind)
    ]
    if expected is None:
        assert code not in ("UNAUTHENTICATED", "PERMISSION_DENIED")
    else:
        assert code == expected


def _call(channel: grpc.Channel, path: str, method: Any, key: str) -> str:
    pool = descriptor_pool.Default()
    asked = message_factory.GetMessageClass(pool.FindMessageTypeByName(method.input_type.full_name))
    told = message_factory.GetMessageClass(pool.FindMessageTypeByName(method.output_type.full_name))
    make = {
        (False, False): channel.unary_unary,
        (False, True): channel.unary_stream,
        (True, False): channel.stream_unary,
        (True, True): channel.stream_stream,
    }[method.client_streaming, method.server_streaming]
    call = make(path, request_serializer=asked.SerializeToString, response_deserializer=told.FromString)
    message = iter([asked()]) if method.client_streaming else asked()
    metadata = (("authorization", f"Bearer {key}"),) if key else ()
    failed: grpc.RpcError | None = None
    try:
        answer = call(message, metadata=metadata, timeout=20)
        if method.server_streaming:
            list(answer)
    except grpc.RpcError as error:
        failed = error
    if failed is None:
        return "OK"
    code = str(failed.code().name)
    assert code not in ("UNAUTHENTICATED", "PERMISSION_DENIED") or rpc_refusal(failed).reason == code
    return code


def test_unknown_rpcs_tell_nothing_without_a_key(locked: Faces, keys: dict[str, str]) -> None:
    for key, expected in (("", "UNAUTHENTICATED"), (keys["write"], "UNIMPLEMENTED")):
        call = locked.channel.unary_unary("/fastsplat.v1.SceneService/Nothing")
        with pytest.raises(grpc.RpcError) as caught:
            call(b"", metadata=(("authorization", f"Bearer {key}"),) if key else ())
        assert caught.value.code().name == expected


@pytest.mark.parametrize(
    "path",
    [
        "/docs%2f..%2fv1/scenes",
        "/docs/../v1/scenes",
        "/web/..%2f..%2fv1/scenes",
        "//v1/scenes",
        "/v1/scenes/",
        "/v1//scenes",
        "/v1/scenes%00",
        "/V1/scenes",
        "/livez/../v1/scenes",
        "/livez%2f",
        "/v1/scenes;/livez",
        "/nothing",
    ],
)
def test_tricks_with_paths_open_no_door(locked: Faces, keys: dict[str, str], path: str) -> None:
    assert _raw(locked, path, "") in (401, 404 if path.startswith("/web/") else 401)
    assert _raw(locked, path, keys["read"]) == 404


def test_a_method_that_a_path_does_not_know_needs_a_key_too(locked: Faces, keys: dict[str, str]) -> None:
    assert locked.rest.patch("/v1/scenes").status_code == 401
    assert locked.rest.patch("/v1/scenes", headers=_header(keys["read"])).status_code == 405
    assert locked.rest.post("/livez").status_code == 401


def _raw(faces: Faces, path: str, key: str) -> int:
    """The status of a request line that no client library tidies up."""
    head = f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n"
    head += f"Authorization: Bearer {key}\r\n" if key else ""
    with socket.create_connection(("127.0.0.1", faces.ports.http), timeout=20) as connection:
        connection.sendall(f"{head}\r\n".encode())
        return int(connection.makefile("rb").readline().split()[1])


def test_the_decision_is_about_the_route_that_answers() -> None:
    app = create_app(None, Settings())
    layer = AccessLayer(app, app, None)
    for context, method in _ROUTES:
        path = re.sub(r"\{kind\}", "rgb", context.path)
        path = re.sub(r"\{\w+\}", "x", path)
        path = f"{path}/file" if context.path in ("/web", "/docs-files") else path
        scope = {"type": "http", "method": method, "path": path, "root_path": "", "headers": []}
        assert layer.matched_route(scope) == route_name(context, method)


def test_both_headers_carry_a_key(locked: Faces, keys: dict[str, str]) -> None:
    for headers in ({"Authorization": f"bearer {keys['read']}"}, {"X-Api-Key": keys["read"]}):
        assert locked.rest.get("/v1/scenes", headers=headers).status_code == 200
        metadata = tuple((name.lower(), value) for name, value in headers.items())
        locked.rpc.ListScenes(pb.ListScenesRequest(), metadata=metadata)
    for headers in (
        {"Authorization": keys["read"]},
        {"Authorization": f"Basic {keys['read']}"},
        {"Cookie": keys["read"]},
    ):
        assert locked.rest.get("/v1/scenes", headers=headers).status_code == 401
    assert locked.rest.get("/v1/scenes", params={"key": keys["read"]}).status_code == 401


def test_health_is_open_and_reflection_is_not(locked: Faces, keys: dict[str, str]) -> None:
    health_pb2_grpc.HealthStub(locked.channel).Check(health_pb2.HealthCheckRequest())
    stub = reflection_pb2_grpc.ServerReflectionStub(locked.channel)

    def asked() -> Iterator[reflection_pb2.ServerReflectionRequest]:
        yield reflection_pb2.ServerReflectionRequest(list_services="")

    with pytest.raises(grpc.RpcError) as caught:
        list(stub.ServerReflectionInfo(asked()))
    assert caught.value.code() == grpc.StatusCode.UNAUTHENTICATED
    assert list(stub.ServerReflectionInfo(asked(), metadata=(("authorization", f"Bearer {keys['read']}"),)))


def test_a_new_key_opens_at_once_and_a_revoked_or_expired_one_soon_no_more(
    locked: Faces, locked_service: SceneService
) -> None:
    held = locked_service.admin.keys
    record, key = held.create("short", "read")
    _wait_for(lambda: locked.rest.get("/v1/scenes", headers=_header(key)).status_code == 200)
    held.revoke(record.id)
    _wait_for(lambda: locked.rest.get("/v1/scenes", headers=_header(key)).status_code == 401)
    _, expiring = held.create("expiring", "read", lifetime_s=3.0)
    _wait_for(lambda: locked.rest.get("/v1/scenes", headers=_header(expiring)).status_code == 200)
    _wait_for(lambda: locked.rest.get("/v1/scenes", headers=_header(expiring)).status_code == 401)


def _wait_for(what: Any) -> None:
    deadline = time.monotonic() + 30
    while not what():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.05)


def test_keys_are_never_logged(locked: Faces, keys: dict[str, str], caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(0)
    locked.rest.get("/v1/scenes", headers=_header(keys["write"]))
    locked.rest.get(f"/v1/scenes/{keys['read']}", headers=_header(keys["read"]))
    locked.rest.get("/v1/scenes", headers=_header(keys["wrong"]), params={"page_token": keys["read"]})
    locked.rpc.ListScenes(pb.ListScenesRequest(), metadata=(("authorization", f"Bearer {keys['write']}"),))
    with pytest.raises(grpc.RpcError):
        locked.rpc.GetScene(pb.GetSceneRequest(scene_id=keys["read"]), metadata=(("x-api-key", keys["read"]),))
    _wait_for(lambda: len([record for record in caplog.records if hasattr(record, "request_id")]) >= 5)
    lines = [JsonLines("api").format(record) for record in caplog.records]
    ours = [json.loads(line) for line in lines if '"request_id"' in line]
    assert any(line["key_id"] and line["milliseconds"] >= 0 for line in ours)
    for secret in (key.split("_", 2)[2] for key in keys.values() if key):
        assert not any(secret in line for line in lines)


def test_keys_lie_in_the_database_as_hashes_alone(
    locked_settings: Settings, locked_service: SceneService, keys: dict[str, str]
) -> None:
    stored = b"".join(path.read_bytes() for path in locked_settings.data_dir.glob("fastsplat.sqlite*"))
    for kind in ("read", "write"):
        assert keys[kind].split("_")[1].encode() in stored
        assert keys[kind].split("_", 2)[2].encode() not in stored


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.7.7", "example.org"])
def test_without_keys_the_server_stays_on_loopback(tmp_path: Path, host: str) -> None:
    with pytest.raises(InvalidInputError) as caught:
        run(Settings(data_dir=tmp_path / "data", host=host, auth="off"))
    assert caught.value.field == "auth" and not (tmp_path / "data").exists()
    check_exposure(Settings(host=host))
    check_exposure(Settings(host="127.0.0.1", auth="off"))


def test_without_keys_pages_of_other_sites_stay_outside(faces: Faces) -> None:
    assert faces.rest.get("/v1/scenes").status_code == 200
    for name in ("Host", "Origin"):
        value = "http://evil.example" if name == "Origin" else "evil.example:8000"
        assert rest_refusal(faces.rest.get("/v1/scenes", headers={name: value})).code == 403
    for value in ("localhost:8000", "[::1]:8000", "127.0.0.1"):
        assert faces.rest.get("/v1/scenes", headers={"Host": value}).status_code == 200
    assert faces.rest.get("/v1/scenes", headers={"Origin": "http://localhost:8000"}).status_code == 200


def test_without_a_source_of_keys_nobody_gets_in() -> None:
    async def asked() -> int:
        transport = httpx.ASGITransport(create_app(None, Settings()))
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return (await client.get("/v1/scenes", headers=_header(f"fsk_{'0' * 12}_{'x' * 43}"))).status_code

    assert asyncio.run(asked()) == 401
