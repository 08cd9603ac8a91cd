"""Keys on the way in: where they may stand, what no key opens, what is logged and stored. See also the matrix."""

from __future__ import annotations

import asyncio
import json
import re
import socket
from collections.abc import Iterator
from pathlib import Path

import grpc
import httpx
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection_pb2, reflection_pb2_grpc

from fastsplat.api.access.exposure import check_exposure, check_local
from fastsplat.api.rest.access import AccessLayer
from fastsplat.api.rest.app import create_app
from fastsplat.api.server import run
from fastsplat.cli.operating.logs import JsonLines
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import InvalidInputError, PermissionDeniedError
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.guarded import ROUTES, Guarded
from tests.api.served import Faces, rest_refusal
from tests.waiting import wait_for


def test_unknown_rpcs_tell_nothing_without_a_key(guarded: Guarded) -> None:
    for caller, expected in (("none", "UNAUTHENTICATED"), ("admin", "UNIMPLEMENTED")):
        call = guarded.faces.channel.unary_unary("/fastsplat.v1.SceneService/Nothing")
        with pytest.raises(grpc.RpcError) as caught:
            call(b"", metadata=guarded.metadata(caller))
        assert caught.value.code().name == expected


@pytest.mark.parametrize(
    "path",
    [
        "/docs%2f..%2fv1/scenes", "/docs/../v1/scenes", "/web/..%2f..%2fv1/scenes", "//v1/scenes", "/v1/scenes/",
        "/v1//scenes", "/v1/scenes%00", "/V1/scenes", "/livez/../v1/scenes", "/livez%2f", "/v1/scenes;/livez",
        "/nothing",
    ],
)  # fmt: skip
def test_tricks_with_paths_open_no_door(guarded: Guarded, path: str) -> None:
    assert _raw(guarded.faces, path, "") in (401, 404 if path.startswith("/web/") else 401)
    assert _raw(guarded.faces, path, guarded.keys["reader"]) == 404


def test_a_method_that_a_path_does_not_know_needs_a_key_too(guarded: Guarded) -> None:
    rest = guarded.faces.rest
    assert rest.patch("/v1/scenes").status_code == rest.post("/livez").status_code == 401
    assert rest.patch("/v1/scenes", headers=guarded.header("reader")).status_code == 405


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
    for route, (method, template) in ROUTES.items():
        path = re.sub(r"\{kind\}", "rgb", template)
        path = re.sub(r"\{\w+\}", "x", path)
        path = f"{path}/file" if template in ("/web", "/docs-files") else path
        scope = {"type": "http", "method": method, "path": path, "root_path": "", "headers": []}
        assert layer.matched_route(scope) == route


def test_both_headers_carry_a_key(guarded: Guarded) -> None:
    for headers in ({"Authorization": f"bearer {guarded.keys['reader']}"}, {"X-Api-Key": guarded.keys["reader"]}):
        assert guarded.faces.rest.get("/v1/scenes", headers=headers).status_code == 200
        metadata = tuple((name.lower(), value) for name, value in headers.items())
        guarded.faces.rpc.ListScenes(pb.ListScenesRequest(), metadata=metadata)
    for headers in (
        {"Authorization": guarded.keys["reader"]},
        {"Authorization": f"Basic {guarded.keys['reader']}"},
        {"Cookie": guarded.keys["reader"]},
    ):
        assert guarded.faces.rest.get("/v1/scenes", headers=headers).status_code == 401
    assert guarded.faces.rest.get("/v1/scenes", params={"key": guarded.keys["reader"]}).status_code == 401


def test_health_is_open_and_reflection_is_not(guarded: Guarded) -> None:
    health_pb2_grpc.HealthStub(guarded.faces.channel).Check(health_pb2.HealthCheckRequest())
    stub = reflection_pb2_grpc.ServerReflectionStub(guarded.faces.channel)

    def requests() -> Iterator[reflection_pb2.ServerReflectionRequest]:
        yield reflection_pb2.ServerReflectionRequest(list_services="")

    with pytest.raises(grpc.RpcError) as caught:
        list(stub.ServerReflectionInfo(requests()))
    assert caught.value.code() == grpc.StatusCode.UNAUTHENTICATED
    (answer,) = stub.ServerReflectionInfo(requests(), metadata=guarded.metadata("reader"))
    names = {service.name for service in answer.list_services_response.service}
    assert {"fastsplat.v1.SceneService", "grpc.health.v1.Health"} <= names


def test_keys_are_never_logged(guarded: Guarded, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(0)
    wrong = "_".join([*guarded.keys["admin"].split("_", 2)[:2], "x" * 43])
    guarded.faces.rest.get("/v1/scenes", headers=guarded.header("admin"))
    guarded.faces.rest.get(f"/v1/scenes/{guarded.keys['reader']}", headers=guarded.header("reader"))
    guarded.faces.rest.get("/v1/scenes", headers={"X-Api-Key": wrong}, params={"page_token": guarded.keys["reader"]})
    guarded.faces.rpc.ListScenes(pb.ListScenesRequest(), metadata=guarded.metadata("admin"))
    with pytest.raises(grpc.RpcError):
        guarded.faces.rpc.GetScene(
            pb.GetSceneRequest(scene_id=guarded.keys["reader"]), metadata=(("x-api-key", guarded.keys["reader"]),)
        )
    wait_for(lambda: len([record for record in caplog.records if hasattr(record, "request_id")]) >= 5)
    lines = [JsonLines("api").format(record) for record in caplog.records]
    ours = [json.loads(line) for line in lines if '"request_id"' in line]
    assert any(line["key_id"] and line["milliseconds"] >= 0 for line in ours)
    for secret in (key.split("_", 2)[2] for key in (guarded.keys["reader"], guarded.keys["admin"], wrong)):
        assert not any(secret in line for line in lines)


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


def test_without_keys_everybody_is_an_operator_of_the_default_project(faces: Faces) -> None:
    named = {"X-Fastsplat-Project": "default"}
    assert faces.rest.get("/v1/scenes", headers=named).json() == faces.rest.get("/v1/scenes").json()
    nowhere = faces.rest.get("/v1/scenes", headers={"X-Fastsplat-Project": "nowhere"})
    assert (rest_refusal(nowhere).code, rest_refusal(nowhere).reason) == (404, "NOT_FOUND")


def test_without_a_source_of_keys_nobody_gets_in() -> None:
    async def requests() -> int:
        transport = httpx.ASGITransport(create_app(None, Settings()))
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return (await client.get("/v1/scenes", headers={"X-Api-Key": f"fsk_{'0' * 12}_{'x' * 43}"})).status_code

    assert asyncio.run(requests()) == 401


_DISGUISED = (
    "http://127.0.0.1:80@evil",
    "http://[::1].evil.example",
    "ftp://localhost",
    "http://localhost:x",
    "://[::1",
)


def test_without_keys_no_origin_of_another_machine_can_be_allowed() -> None:
    for origin in ("https://app.example", "*", *_DISGUISED):
        with pytest.raises(InvalidInputError) as caught:
            check_exposure(Settings(host="127.0.0.1", auth="off", cors_origins=(origin,)))
        assert caught.value.field == "cors_origins" and caught.value.hint
        check_exposure(Settings(host="127.0.0.1", cors_origins=(origin,)))
    check_exposure(Settings(host="127.0.0.1", auth="off", cors_origins=("http://localhost:3000", "http://[::1]:5")))


def test_without_keys_a_page_of_this_machine_is_answered_whatever_its_name_for_it() -> None:
    local_headers = {"host": "127.0.0.1:8000", "sec-fetch-site": "cross-site"}
    check_local({**local_headers, "origin": "http://localhost:3000"})
    for headers in ({}, *({"origin": origin} for origin in ("null", "https://app.example", *_DISGUISED))):
        with pytest.raises(PermissionDeniedError):
            check_local({**local_headers, **headers})
    for host in ("localhost@evil.example", "[::1].evil.example:8000", "localhost:8000/evil"):
        with pytest.raises(PermissionDeniedError):
            check_local({"host": host})
