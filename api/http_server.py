"""HTTP server: uvicorn with limits on request heads and connections, and RFC 9457 errors."""

from __future__ import annotations

import asyncio
import logging
import math
import sys
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import h11
import uvicorn
from fastapi import FastAPI
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from fastsplat.api.rest.problem_answers import problem_response
from fastsplat.api.tls import Tls
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import FastSplatError, InvalidInputError, LimitExceededError, OverloadedError

_log = logging.getLogger(__name__)

_MAX_REQUEST_HEAD = 2**18  # bytes; a 100 kB question in a URL still gets a proper error
_LINGER_S = 2.0
"""Reading time after a refusal; closing earlier could reset the connection before it arrives."""


def make_http_server(app: FastAPI, settings: Settings, tls: Tls | None) -> uvicorn.Server:
    """Builds the server of `app`; run `serve` on sockets, and set `should_exit` to stop it."""
    head_s = settings.limits.head_s

    class Protocol(_TimedProtocol):
        timeout_head = head_s

    bounded = _BoundedConnections(app, settings.limits.connections)
    bounded.server = server = _Server(
        uvicorn.Config(
            bounded,
            http=Protocol,
            ws="none",
            lifespan="on",
            log_config=None,
            access_log=False,
            proxy_headers=bool(settings.trusted_proxies),
            forwarded_allow_ips=list(settings.trusted_proxies),
            server_header=False,
            h11_max_incomplete_event_size=_MAX_REQUEST_HEAD,
            timeout_graceful_shutdown=math.ceil(settings.drain_s),
            ssl_certfile=tls.cert if tls is not None else None,
            ssl_context_factory=None if tls is None else lambda config, default: tls.http_context(),
        )
    )
    return server


class _BoundedConnections:
    """ASGI middleware that limits connections; uvicorn's own limit answers without problem+json."""

    server: uvicorn.Server

    def __init__(self, app: ASGIApp, limit: int) -> None:
        self._app = app
        self._limit = limit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if len(self.server.server_state.connections) <= self._limit:
            await self._app(scope, receive, send)
            return
        error = OverloadedError(
            "as many connections as the server takes are open",
            limit=f"{self._limit} connections",
            hint="Wait a moment, then send it again.",
        )
        answer = _refusal(error)
        answer.headers["Connection"] = "close"
        await answer(scope, receive, send)


class _TimedProtocol(H11Protocol):
    """Closes connections whose request head is not complete in time; uvicorn has no such timeout."""

    timeout_head: float

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._head_timer: asyncio.TimerHandle | None = None
        self._refused = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn's
        super().connection_made(transport)
        self._watch_head()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_timer()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        if self._refused:
            return
        super().data_received(data)
        if not self._refused:
            self._watch_head()

    def shutdown(self) -> None:
        if self._refused:
            self.transport.close()
        else:
            super().shutdown()

    def send_400_response(self, msg: str) -> None:
        """Answers a malformed request; uvicorn calls this while handling h11's error."""
        self._refused = True
        self._stop_timer()
        reason = sys.exc_info()[1]
        begun = self.conn.our_state not in (h11.IDLE, h11.SEND_RESPONSE)
        if self.cycle is not None and not self.cycle.response_complete:  # its body was still being received
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        if begun:  # a response is already under way
            self.transport.close()
            return
        answer = _refusal(_malformed(reason))
        _log.info("request %s is no HTTP: %s", answer.headers["x-request-id"], reason)
        headers = [*answer.raw_headers, (b"connection", b"close")]
        body = b"" if self.cycle is not None and self.cycle.scope["method"] == "HEAD" else bytes(answer.body)
        head = h11.Response(status_code=answer.status_code, headers=headers)
        with suppress(h11.LocalProtocolError):
            for event in (head, h11.Data(data=body), h11.EndOfMessage()):
                self.transport.write(self.conn.send(event) or b"")
        if self.transport.can_write_eof():
            self.flow.resume_reading()
            self.transport.write_eof()
            self.loop.call_later(_LINGER_S, self.transport.close)
        else:
            self.transport.close()

    def _watch_head(self) -> None:
        """Runs the timer while a request head is awaited or incomplete."""
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


def _malformed(error: BaseException | None) -> FastSplatError:
    if getattr(error, "error_status_hint", 400) == 431:
        return LimitExceededError(
            "the head of the request is too large",
            field="headers",
            limit=f"{_MAX_REQUEST_HEAD} bytes",
            hint="Send long questions as a body.",
        )
    return InvalidInputError(
        f"this is no HTTP/1.1 request: {str(error)[:200]}", field="request", hint="Send a request as RFC 9112 has it."
    )


def _refusal(error: FastSplatError) -> Response:
    """Builds the problem response for a request that never reaches the application."""
    request_id = uuid.uuid4().hex
    answer = problem_response(request_id, error)
    answer.headers["X-Request-Id"] = request_id
    answer.headers["X-Content-Type-Options"] = "nosniff"
    answer.headers["Referrer-Policy"] = "no-referrer"
    return answer


class _Server(uvicorn.Server):
    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leaves signals to `run`, which stops both servers."""
        yield
