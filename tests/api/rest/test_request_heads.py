"""Heads of requests as an attacker, a proxy or a foreign page sends them, byte by byte over a socket."""

from __future__ import annotations

import json
import socket
from contextlib import ExitStack

import pytest

from fastsplat.api.rest.middleware import MAX_HEADERS
from fastsplat.service.settings import LimitSettings, Settings
from tests.api.served import Faces, served


def _exchange(faces: Faces, content: bytes) -> tuple[list[int], bytes]:
    """The statuses of all answers to `content`, and what was answered; ends when the server closes or falls silent."""
    with socket.create_connection(("127.0.0.1", faces.ports.http), timeout=30) as connection:
        connection.sendall(content)
        connection.settimeout(1.0)
        received = b""
        try:
            while part := connection.recv(65_536):
                received += part
        except TimeoutError:
            pass
    return [int(line.split()[1]) for line in received.split(b"\r\n") if line.startswith(b"HTTP/1.1 ")], received


def _problem(received: bytes) -> dict[str, object]:
    problem: dict[str, object] = json.loads(received.partition(b"\r\n\r\n")[2])
    return problem


_GET = b"GET /livez HTTP/1.1\r\nHost: localhost\r\n"
_REFUSED = {
    "a length said twice, and a request smuggled behind the body": (
        b"POST /v1/scenes/none:query HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n" + _GET + b"\r\n",
        (400, "content-length"),
    ),
    "a head that is too large, still being written": (_GET + b"X-Long: " + b"a" * 4_000_000, (413, "headers")),
    "more headers than a request needs": (
        _GET + b"".join(b"X-%d: 1\r\n" % number for number in range(MAX_HEADERS)) + b"\r\n",
        (413, "headers"),
    ),
    **{
        f"a host that is none: {host}": (f"GET /livez HTTP/1.1\r\nHost: {host}\r\n\r\n".encode(), (400, "host"))
        for host in ("", "localhost:1@evil.test", "a b", "local/host", "localhost:x")
    },
}


@pytest.mark.parametrize("case", _REFUSED)
def test_a_head_that_is_refused_is_answered_once_with_the_field(faces: Faces, case: str) -> None:
    content, refusal = _REFUSED[case]
    statuses, received = _exchange(faces, content)
    assert len(statuses) == 1 and (statuses[0], _problem(received)["field"]) == refusal


@pytest.mark.parametrize("host", ["localhost", "localhost:8000", "127.0.0.1:1", "[::1]:8000", "a-b.example.org"])
def test_hosts_of_every_kind_pass(faces: Faces, host: str) -> None:
    assert _exchange(faces, f"GET /livez HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())[0] == [200]


_POST = b"POST /v1/scenes HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; boundary=b\r\n"
_GARBAGE = {
    "no request line": b"hello\r\n\r\n",
    "a TLS greeting": b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(300),
    "a method that is none": b"G@T / HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "a version that is none": b"GET / HTTP/x\r\nHost: localhost\r\n\r\n",
    "HTTP/2's preface": b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    "a header without a name": b"GET /livez HTTP/1.1\r\nHost: localhost\r\n: x\r\n\r\n",
    "a NUL in a header": b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX: a\0b\r\n\r\n",
    "two lengths": _POST + b"Content-Length: 4\r\nContent-Length: 5\r\n\r\nabcde",
    "a length that is none": _POST + b"Content-Length: -1\r\n\r\n",
    "a coding that is none": _POST + b"Transfer-Encoding: gzip\r\n\r\n",
    "a bad chunk": _POST + b"Transfer-Encoding: chunked\r\n\r\n5\r\n--b\r\n\r\nxyz\r\n",
    "a HEAD with a bad chunk": b"HEAD /livez HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nxyz\r\n",
}


@pytest.mark.parametrize("case", _GARBAGE)
def test_what_is_no_request_is_answered_with_a_problem(faces: Faces, case: str) -> None:
    statuses, received = _exchange(faces, _GARBAGE[case])
    assert len(statuses) == 1 and b"text/plain" not in received
    if case.startswith("a HEAD"):
        assert statuses in ([200], [400])  # as it comes: the answer may have begun
        return
    assert statuses == [400]
    problem = _problem(received)
    assert (problem["reason"], problem["status"]) == ("INVALID_INPUT", 400)
    assert str(problem["request_id"]).encode() in received.partition(b"\r\n\r\n")[0]
    assert b"application/problem+json" in received and b"connection: close" in received.lower()


def test_an_upgrade_that_is_not_spoken_is_passed_over(faces: Faces) -> None:
    upgrade = b"Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Key: x\r\n\r\n"
    statuses, received = _exchange(faces, b"GET /v1/none HTTP/1.1\r\nHost: localhost\r\n" + upgrade)
    assert statuses == [404]
    assert _problem(received)["reason"] == "NOT_FOUND"


def test_connections_beyond_the_bound_are_refused_with_a_problem(service: object, api_settings: Settings) -> None:
    settings = api_settings.model_copy(update={"limits": LimitSettings(connections=2)})
    with served(service, settings) as few, ExitStack() as stack:
        for _ in range(2):
            connection = stack.enter_context(socket.create_connection(("127.0.0.1", few.ports.http)))
            connection.sendall(b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n")
            assert connection.recv(100).startswith(b"HTTP/1.1 200")
        statuses, received = _exchange(few, b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert statuses == [503]
        assert _problem(received)["reason"] == "OVERLOADED" and b"retry-after" in received.lower()


def test_answers_say_nothing_to_other_sites(faces: Faces) -> None:
    for path in ("/", "/docs", "/livez", "/v1/scenes"):
        headers = faces.rest.get(path).headers
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["x-content-type-options"] == "nosniff"
    for path in ("/", "/docs"):
        assert "frame-ancestors 'none'" in faces.rest.get(path).headers["content-security-policy"]
