"""`/mcp`: assistant tools in this process, with the caller's key, project and limits.

Tools call the REST application in process, so that permissions and errors are the same. A disconnect cancels a call.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from importlib.metadata import version
from typing import TYPE_CHECKING

from starlette.requests import Request
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from fastsplat.api.access.authenticator import Credentials
from fastsplat.api.rest.problem_answers import BodyTooLargeError
from fastsplat.api.rest.responses import while_connected
from fastsplat.service.common.optional_packages import ASSISTANT, needed
from fastsplat_contract.errors import MissingPackageError

if TYPE_CHECKING:
    from fastsplat_client import Client

_MAX_REQUEST_BYTES = 2**18  # bytes; a tool's arguments are short
_CALL_S = 60.0


class Assistant:
    """MCP server of a process; its `lifespan` must be entered, exactly once, before requests."""

    def __init__(self) -> None:
        self._handle: ASGIApp | None = None
        self._missing: MissingPackageError | None = None

    @asynccontextmanager
    async def lifespan(self, app: object) -> AsyncIterator[None]:
        """Runs the MCP session manager, as FastAPI's `lifespan`; without its optional package requests are refused.

        The package is imported here because that takes 0.3 s, which in-process commands should not wait for.
        """
        try:
            with needed(ASSISTANT, "/mcp", ""):
                from mcp.server.transport_security import TransportSecuritySettings

                from fastsplat_client.assistant import assistant_server
        except MissingPackageError as error:
            self._missing = error
            yield
            return
        server = assistant_server(_client_of, version("fastsplat"))
        server.streamable_http_app(
            stateless_http=True,  # any server behind a load balancer may answer
            json_response=True,
            max_request_body_size=_MAX_REQUEST_BYTES,
            # `check_local` has checked the origin already.
            transport_security=TransportSecuritySettings(enable_dns_rebinding_protection=False),
        )
        async with server.session_manager.run():
            self._handle = server.session_manager.handle_request
            yield

    def route(self) -> Route:
        """Builds the route; POST only, because there are no sessions."""
        return Route("/mcp", endpoint=_Endpoint(self._answer), methods=["POST"], name="mcp")

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        if self._missing is not None:
            raise self._missing.with_traceback(None)
        assert self._handle is not None, "the lifespan was not entered"
        await self._handle(scope, receive, send)


class _Endpoint:
    """ASGI application; an object, because Starlette wraps functions as request handlers."""

    def __init__(self, handle: ASGIApp) -> None:
        self._handle = handle

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        from fastsplat.api.rest.in_process import InProcess

        request, body = Request(scope, receive), bytearray()
        async for chunk in request.stream():
            body += chunk
            if len(body) > _MAX_REQUEST_BYTES:
                raise BodyTooLargeError(_MAX_REQUEST_BYTES)
        unread: list[Message] = [{"type": "http.request", "body": bytes(body), "more_body": False}]

        async def replayed() -> Message:
            if not unread:
                await asyncio.Event().wait()  # until a disconnect cancels it
            return unread.pop()

        transport = InProcess(scope["app"], asyncio.get_running_loop(), scope["client"])
        scope["state"]["in_process"] = transport
        try:
            await while_connected(request, self._handle(scope, replayed, send))
        finally:
            transport.stop()


@contextmanager
def _client_of(request: Request) -> Iterator[Client]:
    """Opens a client of this process with the caller's key, project and address."""
    from fastsplat_client import Client, Retry

    credentials = Credentials.of(request.headers)
    with Client(
        "http://localhost",
        key=credentials.key,
        project=credentials.project,
        timeout_s=_CALL_S,
        retry=Retry(tries=1),  # refusals are reported to the assistant at once
        transport=request.scope["state"]["in_process"],
    ) as client:
        yield client
