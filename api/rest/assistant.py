"""`/mcp`: the tools of an assistant in this process, under the caller's key, project and limits.

A tool asks the service as any client does, through the whole application: what a key may not do over REST, no tool of
it does, and a refusal is the same to the word.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from importlib.metadata import version
from typing import Any

import httpx
from mcp.server.transport_security import TransportSecuritySettings
from starlette.requests import Request
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from fastsplat.api.access.authenticator import Credentials
from fastsplat_client import Client, Retry
from fastsplat_client.assistant import assistant_server

_MAX_REQUEST_BYTES = 2**18  # a tool's arguments are a few lines
_CALL_S = 60.0


class Assistant:
    """The MCP server of a process; `lifespan` must be entered before it answers, and can be once."""

    def __init__(self) -> None:
        server = assistant_server(_client_of, version("fastsplat"))
        server.streamable_http_app(
            stateless_http=True,  # so that any server behind a balancer may answer any call
            json_response=True,
            max_request_body_size=_MAX_REQUEST_BYTES,
            # Who asks from where is looked at before, see `check_local`.
            transport_security=TransportSecuritySettings(enable_dns_rebinding_protection=False),
        )
        self._sessions = server.session_manager

    @asynccontextmanager
    async def lifespan(self, app: object) -> AsyncIterator[None]:
        """Hold what answers open, as FastAPI's `lifespan`."""
        async with self._sessions.run():
            yield

    def route(self) -> Route:
        """POST alone: there are no sessions to stream to or to end."""
        return Route("/mcp", endpoint=_Endpoint(self._sessions.handle_request), methods=["POST"], name="mcp")


class _Endpoint:
    """An ASGI application, which Starlette knows from a function by its being an object."""

    def __init__(self, handle: ASGIApp) -> None:
        self._handle = handle

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        scope["state"]["loop"] = asyncio.get_running_loop()
        await self._handle(scope, receive, send)


@contextmanager
def _client_of(request: Request) -> Iterator[Client]:
    """A client of this very process, with the caller's key, project and address."""
    credentials = Credentials.of(request.headers)
    transport = _InProcess(request.scope, request.scope["state"]["loop"])
    with Client(
        "http://localhost",
        key=credentials.key,
        project=credentials.project,
        timeout_s=_CALL_S,
        retry=Retry(tries=1),  # what is refused now, the assistant is to hear
        transport=transport,
    ) as client:
        yield client


class _InProcess(httpx.BaseTransport):
    """Carries a worker thread's requests into the application on its event loop."""

    def __init__(self, scope: Scope, loop: asyncio.AbstractEventLoop) -> None:
        self._inner = httpx.ASGITransport(scope["app"], raise_app_exceptions=False, client=scope["client"])
        self._loop = loop

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        return asyncio.run_coroutine_threadsafe(self._answer(request), self._loop).result()

    async def _answer(self, request: httpx.Request) -> httpx.Response:
        headers: dict[str, Any] = {**request.headers, "accept-encoding": "identity"}
        inner = httpx.Request(request.method, request.url, headers=headers, content=request.read())
        response = await self._inner.handle_async_request(inner)
        content = await response.aread()
        return httpx.Response(response.status_code, headers=response.headers, content=content)
