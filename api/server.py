"""API server: HTTP and gRPC in one process on one event loop."""

from __future__ import annotations

import asyncio
import logging
import resource
import signal
import socket
import sys
from collections.abc import Callable
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from importlib import import_module

from fastsplat.api.access.exposure import check_exposure, is_loopback
from fastsplat.api.access.gate import build_gate
from fastsplat.api.grpc.server import start_server
from fastsplat.api.health import Readiness
from fastsplat.api.http_server import make_http_server
from fastsplat.api.metrics import Metrics, serve_metrics
from fastsplat.api.rest.app import create_app
from fastsplat.api.threads import Threads
from fastsplat.api.tls import tls_of
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.jobs.needed_models import log_missing_models
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import ResourceError

_log = logging.getLogger(__name__)

_TURN_S = 0.001  # longest time that a computing thread may block the event loop, and with it /livez
_MOST_FILES = 65_536


@dataclass(frozen=True)
class Ports:
    """Ports of HTTP, gRPC and metrics."""

    http: int
    grpc: int
    metrics: int


def run(settings: Settings) -> None:
    """Serves REST and gRPC until SIGTERM or SIGINT, then lets running calls finish.

    Raises:
        InvalidInputError: keys are off and the host is not loopback, or the TLS files cannot be used.
        ResourceError: a port, the data folder or the database is not available.
    """

    async def until_signal() -> None:
        stop = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        await serve(service, settings, stop)

    check_exposure(settings)
    import_module("fastsplat.service.query.drawing.scene_renderer")  # SciPy fails while another thread imports torch
    sys.setswitchinterval(_TURN_S)
    _raise_file_limit()
    with open_service(settings) as service:
        if not is_loopback(settings.host) and settings.tls_cert is None:
            _log.warning("on %s, keys and pictures travel unencrypted; see FASTSPLAT_TLS_CERT", settings.host)
        if settings.auth == "on" and service.admin.keys.ensure_first(settings.first_key):
            _log.info("the first key is in %s", settings.first_key)
        asyncio.run(until_signal())


async def serve(
    service: SceneService,
    settings: Settings,
    stop: asyncio.Event,
    on_ready: Callable[[Ports], None] = lambda ports: None,
) -> None:
    """Serves both protocols until `stop` is set.

    The server then reports "not ready" for `drain_notice_s`, takes no new calls, and gives running ones `drain_s`.

    Args:
        service: a SceneService; any other object has no keys and no metrics of jobs, and is always ready.
        settings: port 0 takes a free one.
        on_ready: called once with the actual ports when both protocols answer.

    Raises:
        InvalidInputError: as `run`.
        ResourceError: a port is not available.
    """
    check_exposure(settings)
    tls = tls_of(settings)
    admin = service.admin if isinstance(service, SceneService) else None
    metrics = Metrics()
    if admin is not None:
        log_missing_models(admin.settings_in_use)
        metrics.watch_jobs(admin.metrics)
    gate = build_gate(settings, admin, metrics)
    readiness = Readiness(admin.check_ready if admin is not None else lambda: None)
    threads = Threads(settings.limits, metrics, settings.uploads)
    async with AsyncExitStack() as opened:
        opened.push_async_callback(asyncio.to_thread, threads.close)
        listeners = _listen(settings.host, settings.http_port)
        for listener in listeners:
            opened.callback(listener.close)
        metrics_port, stop_metrics = serve_metrics(metrics, settings.metrics_host, settings.metrics_port)
        opened.push_async_callback(asyncio.to_thread, stop_metrics)
        grpc_server = await start_server(
            service, threads, settings.host, settings.grpc_port, gate, tls, settings.limits
        )
        app = create_app(service, settings, threads, gate, readiness, grpc_server.port)
        http_server = make_http_server(app, settings, tls)
        serving = asyncio.create_task(http_server.serve(listeners))
        stopping = asyncio.create_task(stop.wait())
        watching: asyncio.Task[None] | None = None
        try:
            while not http_server.started and not serving.done():
                await asyncio.sleep(0.01)
            await readiness.look()
            await grpc_server.tell(readiness.ready)
            watching = asyncio.create_task(readiness.watch(grpc_server.tell))
            ports = Ports(listeners[0].getsockname()[1], grpc_server.port, metrics_port)
            scheme = "http" if tls is None else "https"
            _log.info("HTTP on %s://%s:%d, gRPC on %s:%d", scheme, settings.host, ports.http, settings.host, ports.grpc)
            on_ready(ports)
            await asyncio.wait((serving, stopping), return_when=asyncio.FIRST_COMPLETED)
            readiness.drain()
            await grpc_server.tell(False)
            _log.info("draining")
            await asyncio.sleep(settings.drain_notice_s)
        finally:
            if watching is not None:
                watching.cancel()
            http_server.should_exit = True
            await asyncio.gather(grpc_server.stop(settings.drain_s), serving)
            stopping.cancel()


def _raise_file_limit() -> None:
    """Raises the soft limit of open files, by default often 1024, for many connections."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    enough = _MOST_FILES if hard == resource.RLIM_INFINITY else min(hard, _MOST_FILES)
    if soft != resource.RLIM_INFINITY and soft < enough:
        resource.setrlimit(resource.RLIMIT_NOFILE, (enough, hard))


def _listen(host: str, port: int) -> list[socket.socket]:
    """Opens sockets; for loopback IPv4 and IPv6, because browsers use either for "localhost"."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        listeners = [socket.create_server((host, port), family=family, backlog=2048)]
    except OSError as error:
        raise ResourceError(
            f"HTTP cannot listen on {host}:{port}: {error.strerror}",
            field="http_port",
            hint="Set FASTSPLAT_HTTP_PORT to a free port.",
        ) from error
    if host in ("127.0.0.1", "localhost", "::1"):
        loopback = ("::1", socket.AF_INET6) if family == socket.AF_INET else ("127.0.0.1", socket.AF_INET)
        with suppress(OSError):  # no IPv6, or the port is taken there
            address = (loopback[0], listeners[0].getsockname()[1])
            listeners.append(socket.create_server(address, family=loopback[1], backlog=2048))
    for listener in listeners:
        # Inherited by connections. asyncio sets it only on listeners of its own, and without it every answer waits
        # 40 ms for the client's delayed ACK of its head.
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listeners
