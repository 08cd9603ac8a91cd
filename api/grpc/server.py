"""gRPC server on `grpc.aio`, because idle streams must not hold threads."""

from __future__ import annotations

from dataclasses import dataclass

from grpc import aio
from grpc_health.v1 import health, health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection

from fastsplat.api.access.caller import in_callers_project
from fastsplat.api.access.gate import Gate
from fastsplat.api.grpc.interceptors import AccessInterceptor
from fastsplat.api.grpc.rpcs import add_rpcs
from fastsplat.api.grpc.upload import MAX_MESSAGE_BYTES
from fastsplat.api.threads import Threads
from fastsplat.api.tls import Tls
from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import LimitSettings
from fastsplat_contract.errors import ResourceError
from fastsplat_contract.v1 import fastsplat_pb2

_STREAMS_PER_CONNECTION = 256
"""Concurrent calls per connection."""
_IDLE_S = 300.0
"""Time after which a connection without calls is closed."""

_SERVICE = fastsplat_pb2.DESCRIPTOR.services_by_name["SceneService"].full_name


@dataclass(frozen=True)
class RunningServer:
    """A started server and the port it listens on."""

    port: int
    _server: aio.Server
    _health: health.aio.HealthServicer

    async def tell(self, ready: bool) -> None:
        """Sets the status that health checks report."""
        status = health_pb2.HealthCheckResponse.SERVING if ready else health_pb2.HealthCheckResponse.NOT_SERVING
        for name in ("", _SERVICE):
            await self._health.set(name, status)

    async def stop(self, grace_s: float) -> None:
        """Reports NOT_SERVING, takes no new calls, and gives running ones `grace_s` seconds."""
        await self._health.enter_graceful_shutdown()
        await self._server.stop(grace_s)


async def start_server(
    service: SceneService, threads: Threads, host: str, port: int, gate: Gate, tls: Tls | None, limits: LimitSettings
) -> RunningServer:
    """Starts the server with reflection and health checks, NOT_SERVING at first.

    Port 0 takes a free one. Raises `ResourceError` if the port is not available.
    """
    server = aio.server(
        interceptors=[AccessInterceptor(gate)],
        maximum_concurrent_rpcs=limits.connections,
        options=[
            ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
            ("grpc.max_concurrent_streams", _STREAMS_PER_CONNECTION),
            ("grpc.max_connection_idle_ms", round(_IDLE_S * 1000)),
            ("grpc.server_handshake_timeout_ms", round(limits.head_s * 1000)),
            ("grpc.keepalive_time_ms", 60_000),  # detects clients that lost their network
            ("grpc.keepalive_timeout_ms", 20_000),
            ("grpc.http2.min_ping_interval_without_data_ms", 10_000),
            ("grpc.so_reuseport", 0),  # otherwise two servers could silently share a port
        ],
    )
    add_rpcs(server, in_callers_project(service), threads)
    checks = health.aio.HealthServicer()
    health_pb2_grpc.add_HealthServicer_to_server(checks, server)
    reflection.enable_server_reflection((_SERVICE, health.SERVICE_NAME, reflection.SERVICE_NAME), server)
    address = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    try:
        if tls is None:
            bound = server.add_insecure_port(address)
        else:
            bound = server.add_secure_port(address, tls.grpc_credentials())
    except RuntimeError as error:
        raise ResourceError(
            f"gRPC cannot listen on {host}:{port}", field="grpc_port", hint="Set FASTSPLAT_GRPC_PORT to a free port."
        ) from error
    await server.start()
    running = RunningServer(bound, server, checks)
    await running.tell(False)
    return running
