"""The HTTP server: uvicorn, with time limits on request heads and a bound on connections."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import h11
import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol

from fastsplat.api.tls import Tls
from fastsplat.service.settings import Settings

_MAX_REQUEST_HEAD = 2**18  # so that a question of 100 kB in a URL gets an answer that says what is wrong with it


def make_http_server(app: FastAPI, settings: Settings, tls: Tls | None) -> uvicorn.Server:
    """The server of `app`; `serve` it on a socket, and set `should_exit` to end it."""
    head_s = settings.limits.head_s

    class Protocol(_TimedProtocol):
        timeout_head = head_s

    return _Server(
        uvicorn.Config(
            app,
            http=Protocol,
            ws="none",
            lifespan="off",
            log_config=None,
            access_log=False,
            proxy_headers=bool(settings.trusted_proxies),
            forwarded_allow_ips=list(settings.trusted_proxies),
            server_header=False,
            limit_concurrency=settings.limits.connections,
            h11_max_incomplete_event_size=_MAX_REQUEST_HEAD,
            timeout_graceful_shutdown=math.ceil(settings.drain_s),
            ssl_certfile=tls.cert if tls is not None else None,
            ssl_context_factory=None if tls is None else lambda config, default: tls.http_context(),
        )
    )


class _TimedProtocol(H11Protocol):
    """Closes a connection whose request head is not whole in time; uvicorn itself waits for ever."""

    timeout_head: float

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._head_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._watch_head()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_timer()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._watch_head()

    def _watch_head(self) -> None:
        """Run the timer while a head is awaited or only part of one has come."""
        if self.conn.their_state is not h11.IDLE:
            self._stop_timer()
        elif self._head_timer is None:
            self._head_timer = self.loop.call_later(self.timeout_head, self._end)

    def _end(self) -> None:
        self._head_timer = None
        if self.conn.their_state is h11.IDLE and not self.transport.is_closing():
            self.transport.close()

    def _stop_timer(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None


class _Server(uvicorn.Server):
    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave the signals to `run`, which has two servers to stop."""
        yield
