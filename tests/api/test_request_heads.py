"""Heads of requests as an attacker, a proxy or a foreign page sends them, byte by byte over a socket."""

from __future__ import annotations

import json
import socket
import ssl
from pathlib import Path

import httpx
import pytest

from fastsplat.api.rest.request_heads import MAX_HEADERS
from fastsplat.service.settings import Settings
from tests.api.served import Faces, serving


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


def test_a_body_whose_length_is_said_twice_is_refused_and_nothing_after_it_is_read(faces: Faces) -> None:
    smuggled = b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n"
    statuses, received = _exchange(
        faces,
        b"POST /v1/scenes/none:query HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n" + smuggled,
    )
    assert statuses == [400]
    assert _problem(received)["field"] == "content-length"


@pytest.mark.parametrize("host", ["", "localhost:1@evil.test", "a b", "local/host", "localhost:x"])
def test_a_host_that_is_none_is_refused(faces: Faces, host: str) -> None:
    statuses, received = _exchange(faces, f"GET /livez HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
    assert statuses == [400]
    assert _problem(received)["field"] == "host"


@pytest.mark.parametrize("host", ["localhost", "localhost:8000", "127.0.0.1:1", "[::1]:8000", "a-b.example.org"])
def test_hosts_of_every_kind_pass(faces: Faces, host: str) -> None:
    assert _exchange(faces, f"GET /livez HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())[0] == [200]


def test_more_headers_than_a_request_needs_are_refused(faces: Faces) -> None:
    lines = "".join(f"X-{number}: 1\r\n" for number in range(MAX_HEADERS))
    statuses, received = _exchange(faces, f"GET /livez HTTP/1.1\r\nHost: localhost\r\n{lines}\r\n".encode())
    assert statuses == [413]
    assert _problem(received)["field"] == "headers"


def test_answers_say_nothing_to_other_sites(faces: Faces) -> None:
    for path in ("/", "/docs", "/livez", "/v1/scenes"):
        headers = faces.rest.get(path).headers
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["x-content-type-options"] == "nosniff"
    for path in ("/", "/docs"):
        assert "frame-ancestors 'none'" in faces.rest.get(path).headers["content-security-policy"]


def test_without_keys_an_image_on_another_sites_page_is_refused(faces: Faces) -> None:
    refused = faces.rest.get("/v1/scenes", headers={"Sec-Fetch-Site": "cross-site"})
    assert (refused.status_code, refused.json()["field"]) == (403, "sec-fetch-site")
    assert faces.rest.get("/v1/scenes", headers={"Sec-Fetch-Site": "same-origin"}).status_code == 200


def test_with_tls_browsers_are_told_to_stay_with_it(service: object, api_settings: Settings, pem: Path) -> None:
    own = api_settings.model_copy(update={"tls_cert": pem / "server.pem", "tls_key": pem / "server.key"})
    context = ssl.create_default_context(cafile=str(pem / "ca.pem"))
    with serving(service, own) as ports:
        answer = httpx.get(f"https://127.0.0.1:{ports.http}/livez", verify=context)
    assert "max-age" in answer.headers["strict-transport-security"]
