"""Both faces in one process, on one event loop."""

from __future__ import annotations

import asyncio
import logging
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import uvicorn

from api.grpc.server import start_server
from api.rest.app import create_app
from api.threads import Threads
from service.calls.service import SceneService, open_service
from service.common.errors import ResourceError
from service.settings import Settings

_log = logging.getLogger(__name__)

_GRACE_S = 10
_MAX_REQUEST_HEAD = 2**18  # so that a question of 100 kB in a URL gets an answer that says what is wrong with it


@dataclass(frozen=True)
class Ports:
    """Where the faces listen."""

    http: int
    grpc: int


def run(settings: Settings) -> None:
    """Serve REST on host:http_port and gRPC on host:grpc_port until SIGTERM or SIGINT; running calls may finish.

    Raises:
        ResourceError: a port, the data folder or the database cannot be had.
    """

    async def until_signal() -> None:
        stop = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        await serve(service, settings, stop)

    with open_service(settings) as service:
        asyncio.run(until_signal())


async def serve(
    service: SceneService,
    settings: Settings,
    stop: asyncio.Event,
    on_ready: Callable[[Ports], None] = lambda ports: None,
) -> None:
    """Serve both faces until `stop` is set; port 0 takes a free one, and `on_ready` tells which.

    Raises:
        ResourceError: a port cannot be had.
    """
    threads = Threads()
    listener = _listen(settings.host, settings.http_port)
    try:
        grpc_server = await start_server(service, threads, settings.host, settings.grpc_port)
    except ResourceError:
        listener.close()
        raise
    http_server = _Server(
        uvicorn.Config(
            create_app(service, settings, threads),
            http="h11",
            ws="none",
            lifespan="off",
            log_config=None,
            access_log=False,
            proxy_headers=False,
            server_header=False,
            h11_max_incomplete_event_size=_MAX_REQUEST_HEAD,
            timeout_graceful_shutdown=_GRACE_S,
        )
    )
    serving = asyncio.create_task(http_server.serve([listener]))
    stopping = asyncio.create_task(stop.wait())
    try:
        while not http_server.started and not serving.done():
            await asyncio.sleep(0.01)
        ports = Ports(listener.getsockname()[1], grpc_server.port)
        _log.info("HTTP on http://%s:%d, gRPC on %s:%d", settings.host, ports.http, settings.host, ports.grpc)
        on_ready(ports)
        await asyncio.wait((serving, stopping), return_when=asyncio.FIRST_COMPLETED)
    finally:
        http_server.should_exit = True
        await asyncio.gather(grpc_server.stop(_GRACE_S), serving)
        stopping.cancel()
        await asyncio.to_thread(threads.close)


class _Server(uvicorn.Server):
    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave the signals to `run`, which has two servers to stop."""
        yield


def _listen(host: str, port: int) -> socket.socket:
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        listener = socket.create_server((host, port), family=family, backlog=2048)
    except OSError as error:
        raise ResourceError(
            f"HTTP cannot listen on {host}:{port}: {error.strerror}",
            field="http_port",
            hint="Set FASTSPLAT_HTTP_PORT to a free port.",
        ) from error
    # Connections inherit this. asyncio sets it only where it opened the listener itself, and without it every answer
    # waits 40 ms for the client's delayed acknowledgement of its head.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listener
