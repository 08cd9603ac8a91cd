"""Connections that do nothing are closed; a validation ends with its caller."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from fastsplat.service.application.service import open_service
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.settings import LimitSettings, Settings
from tests.api.served import Faces, served
from tests.waiting import wait_for, with_growing_limit


@pytest.fixture
def strict(api_settings: Settings, tmp_path: Path) -> Iterator[Faces]:
    """A server that waits half a second for the head of a request."""
    settings = api_settings.model_copy(update={"data_dir": tmp_path / "data", "limits": LimitSettings(head_s=0.5)})
    with open_service(settings) as service, served(service, settings) as faces:
        yield faces


@pytest.mark.parametrize("beginning", [b"", b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Long: ", b"G"])
def test_a_head_that_does_not_come_is_not_waited_for(strict: Faces, beginning: bytes) -> None:
    with socket.create_connection(("127.0.0.1", strict.ports.http), timeout=30) as connection:
        connection.sendall(beginning)
        assert connection.recv(100) == b""  # closed by the server


def test_a_second_head_is_not_waited_for_either_and_whole_ones_are_answered(strict: Faces) -> None:
    with socket.create_connection(("127.0.0.1", strict.ports.http), timeout=30) as connection:
        connection.sendall(b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\nGET /livez HTTP/1.1\r\nHost")
        answer = b""
        while piece := connection.recv(10_000):
            answer += piece
    assert answer.count(b"HTTP/1.1 200") == 1


def test_a_validation_ends_when_its_client_leaves(api_settings: Settings, tmp_path: Path) -> None:
    begun, stopped = threading.Event(), threading.Event()

    def endless(folder: Path, settings: CaptureSettings, strict: bool) -> ValidatedUpload:
        begun.set()
        try:
            while True:
                check_cancelled()
        finally:
            stopped.set()

    settings = api_settings.model_copy(update={"data_dir": tmp_path / "data"})
    with open_service(settings, endless) as service, served(service, settings) as faces:

        def leave(limit_s: float) -> bool | None:
            with pytest.raises(httpx.TimeoutException):
                faces.rest.post("/v1/scenes", files={"images": ("a.jpg", b"picture")}, timeout=limit_s)
            return begun.is_set() or None

        assert with_growing_limit(leave, 0.3)
        assert stopped.wait(60)
        uploads = settings.data_dir / "uploads"
        wait_for(lambda: not list(uploads.iterdir()))  # until the thread has removed what came
