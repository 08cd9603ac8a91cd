"""Every typed error, and one that is not ours, says the same over both protocols."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import grpc
import pytest

from fastsplat.api.errors import refusal_of
from fastsplat_contract import errors
from fastsplat_contract.errors import FastSplatError, Kind
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.served import Faces, on_free_ports, rest_refusal, rpc_refusal, served

_ROOT = Path(__file__).parents[3]
_HTTP = {  # by the kind of an error, which is its status over gRPC
    Kind.INVALID_ARGUMENT: 400, Kind.UNAUTHENTICATED: 401, Kind.PERMISSION_DENIED: 403, Kind.NOT_FOUND: 404,
    Kind.ALREADY_EXISTS: 409, Kind.FAILED_PRECONDITION: 409, Kind.CANCELLED: 499, Kind.INTERNAL: 500,
    Kind.RESOURCE_EXHAUSTED: 503, Kind.UNAVAILABLE: 503, Kind.DEADLINE_EXCEEDED: 504,
}  # fmt: skip
_HTTP_TELLS_APART = {
    errors.QuotaError: 403,
    errors.MethodNotAllowedError: 405,
    errors.TusVersionError: 412,
    errors.LimitExceededError: 413,
    errors.UnsupportedMediaTypeError: 415,
    errors.RangeNotSatisfiableError: 416,
    errors.UploadLockedError: 423,
    errors.RateLimitedError: 429,
    errors.ChecksumMismatchError: 460,
}
_GRPC_TELLS_APART = {errors.MethodNotAllowedError: "UNIMPLEMENTED", errors.RangeNotSatisfiableError: "OUT_OF_RANGE"}
_STATUSES = {
    kind: (_HTTP_TELLS_APART.get(kind, _HTTP[kind.kind]), _GRPC_TELLS_APART.get(kind, kind.kind.name))
    for kind in vars(errors).values()
    if isinstance(kind, type) and issubclass(kind, FastSplatError)
}


class _Refusing:
    """A service layer that raises what it is told to."""

    def __init__(self) -> None:
        self.error: Exception = FastSplatError("")

    def __getattr__(self, name: str) -> Any:
        def call(*args: object, **kwargs: object) -> None:
            raise self.error

        return call


@pytest.fixture(scope="module")
def refusing() -> _Refusing:
    return _Refusing()


@pytest.fixture(scope="module")
def refused(refusing: _Refusing) -> Iterator[Faces]:
    with served(refusing, on_free_ports()) as faces:
        yield faces


def _calls(faces: Faces) -> tuple[Any, Any]:
    response = faces.rest.get("/v1/scenes/x")
    with pytest.raises(grpc.RpcError) as caught:
        faces.rpc.GetScene(pb.GetSceneRequest(scene_id="x"))
    return response, caught.value


def test_no_error_of_the_server_stands_outside_the_tree() -> None:
    for folder in ("api", "cli", "service", "workers"):
        for path in (_ROOT / folder).rglob("*.py"):
            assert not re.search(r"^class \w+\([\w.]*Error\b", path.read_text(), re.MULTILINE), path


@pytest.mark.parametrize("kind", _STATUSES)
def test_both_protocols_carry_the_whole_error(refused: Faces, refusing: _Refusing, kind: type[FastSplatError]) -> None:
    refusing.error = kind("an object is wrong: ünïcode", hint="Do this.", field="images[3]", limit="5 m")
    response, failure = _calls(refused)
    rest, rpc = rest_refusal(response), rpc_refusal(failure)
    assert (rest.code, rpc.code) == _STATUSES[kind]
    assert rest.reason == rpc.reason == kind.reason
    assert rest.detail == rpc.detail == "an object is wrong: ünïcode"
    assert rest.details == rpc.details == {"hint": "Do this.", "field": "images[3]", "limit": "5 m"}


def test_an_unexpected_exception_reveals_nothing_and_is_logged_by_its_id(
    refused: Faces, refusing: _Refusing, caplog: pytest.LogCaptureFixture
) -> None:
    refusing.error = RuntimeError("secret path /etc/passwd")
    response, failure = _calls(refused)
    assert (rest_refusal(response).code, rpc_refusal(failure).code) == (500, "INTERNAL")
    assert "secret" not in response.text and "secret" not in failure.details()
    assert rest_refusal(response).detail == rpc_refusal(failure).detail
    logged = [record for record in caplog.records if response.headers["x-request-id"] in record.getMessage()]
    assert any(record.exc_info and "secret" in str(record.exc_info[1]) for record in logged)


def test_a_huge_message_is_cut_before_it_breaks_the_trailers(refused: Faces, refusing: _Refusing) -> None:
    refusing.error = errors.InvalidInputError("x" * 100_000, field="y" * 100_000)
    response, failure = _calls(refused)
    assert rest_refusal(response).detail == rpc_refusal(failure).detail
    assert len(rpc_refusal(failure).detail) == 1000


def test_request_ids_are_taken_over_when_they_are_plain(refused: Faces, refusing: _Refusing) -> None:
    refusing.error = errors.NotFoundError("no")
    plain = refused.rest.get("/v1/scenes/x", headers={"X-Request-Id": "robot-7.a_b"})
    assert plain.headers["x-request-id"] == plain.json()["request_id"] == "robot-7.a_b"
    odd = refused.rest.get("/v1/scenes/x", headers={"X-Request-Id": "a b" * 100})
    assert odd.headers["x-request-id"] not in ("", "a b" * 100)
    with pytest.raises(grpc.RpcError) as caught:
        refused.rpc.GetScene(pb.GetSceneRequest(scene_id="x"), metadata=(("x-request-id", "robot-8"),))
    assert refusal_of(refusing.error, "robot-8").as_rpc_status().SerializeToString() == dict(
        caught.value.trailing_metadata()
    ).get("grpc-status-details-bin")


def test_unknown_routes_and_methods_are_problems_too(refused: Faces) -> None:
    assert rest_refusal(refused.rest.get("/v2/nothing")).code == 404
    assert rest_refusal(refused.rest.get("/web/../server.py")).code == 404
    assert rest_refusal(refused.rest.get("/web/nothing.js")).code == 404
    patched = refused.rest.patch("/v1/scenes")
    assert rest_refusal(patched).reason == "METHOD_NOT_ALLOWED" and patched.status_code == 405
    assert set(patched.headers["allow"].split(", ")) >= {"GET"}
