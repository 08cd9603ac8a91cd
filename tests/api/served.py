"""Both faces on free loopback ports, on a thread of their own."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import grpc
import httpx
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from fastsplat.api.server import Ports, serve
from fastsplat.service.application.service import SceneService
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.settings import Settings
from fastsplat_client.stream import SceneServiceStub
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.messages.queries import QueryOut, QueryRequest


@dataclass(frozen=True)
class Faces:
    """A client of each face."""

    rest: httpx.Client
    rpc: SceneServiceStub
    channel: grpc.Channel
    ports: Ports


def on_free_ports(**settings: Any) -> Settings:
    """Of a server on free ports that wants no keys, but for what is given."""
    return Settings(**{"http_port": 0, "grpc_port": 0, "metrics_port": 0, "auth": "off"} | settings)


@contextmanager
def serving(service: Any, settings: Settings) -> Iterator[Ports]:
    ready = threading.Event()
    state: dict[str, Any] = {}

    async def main() -> None:
        state["loop"], state["stop"] = asyncio.get_running_loop(), asyncio.Event()

        def on_ready(ports: Ports) -> None:
            state["ports"] = ports
            ready.set()

        await serve(service, settings, state["stop"], on_ready)

    thread = threading.Thread(target=lambda: asyncio.run(main()))
    thread.start()
    assert ready.wait(120)
    try:
        yield state["ports"]
    finally:
        state["loop"].call_soon_threadsafe(state["stop"].set)
        thread.join(60)
        assert not thread.is_alive(), "the server did not stop"


@contextmanager
def served(service: Any, settings: Settings) -> Iterator[Faces]:
    with (
        serving(service, settings) as ports,
        httpx.Client(base_url=f"http://127.0.0.1:{ports.http}", timeout=600) as rest,
        grpc.insecure_channel(f"127.0.0.1:{ports.grpc}") as channel,
    ):
        yield Faces(rest, SceneServiceStub(channel), channel, ports)


@dataclass(frozen=True)
class Refusal:
    """An error as a client saw it, in the words both protocols share."""

    code: str | int
    reason: str
    detail: str
    details: dict[str, str]


def rest_refusal(response: httpx.Response) -> Refusal:
    assert response.headers["content-type"] == "application/problem+json", response.text
    body = response.json()
    assert body["status"] == response.status_code and body["title"] and body["type"].startswith("urn:fastsplat:")
    assert body["request_id"] == response.headers["x-request-id"]
    details = {name: body[name] for name in ("field", "limit", "hint") if name in body}
    return Refusal(response.status_code, body["reason"], body["detail"], details)


def rpc_refusal(error: grpc.RpcError) -> Refusal:
    """The google.rpc.Status of a failed call."""
    status = rpc_status.from_call(error)
    assert status is not None and status.code == error.code().value[0]
    info = error_details_pb2.ErrorInfo()
    assert status.details[0].Unpack(info)
    assert info.domain == "fastsplat"
    details = dict(info.metadata)
    assert details.pop("request_id")
    return Refusal(error.code().name, info.reason, status.message, details)


class OwnQuestions:
    """A service that answers questions in a way of its own, and all else as another one."""

    def __init__(self, service: SceneService) -> None:
        self._service = service
        self.begun, self.stopped = threading.Event(), threading.Event()

    @property
    def answers(self) -> OwnQuestions:
        return self

    def __getattr__(self, name: str) -> Any:
        return getattr(self._service, name)


class EndlessQuestions(OwnQuestions):
    """A service whose questions end only by being stopped."""

    def query(self, request: QueryRequest, subscription: Any = None) -> QueryOut:
        self.begun.set()
        try:
            while True:
                check_cancelled()
                time.sleep(0.005)
        finally:
            self.stopped.set()


class SlowScenes:
    """A service whose one call takes as long as the test wants."""

    def __init__(self) -> None:
        self.release = threading.Event()
        self.running = threading.Semaphore(0)

    def get_scene(self, scene_id: str) -> None:
        self.running.release()
        self.release.wait(60)
        raise NotFoundError("no scene")
