"""Outermost middleware: request ids, HEAD, limits on headers and bodies, and error answers."""

from __future__ import annotations

import asyncio
import logging
import re
import time

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from fastsplat.api.access.access_log import log_request
from fastsplat.api.errors import accepted_request_id
from fastsplat.api.rest.problem_answers import BodyTooLargeError, problem_response
from fastsplat.api.rest.standard_http import head_as_get
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, NotReadyNowError

MAX_HEADERS = 100
"""Limit of header lines; browsers send about 20."""

_HOST = re.compile(r"([\w.~-]+|\[[0-9A-Fa-f:.%]+\])(:[0-9]{1,5})?")
_log = logging.getLogger(__name__)
_UPLOADS = re.compile(r"POST /v1/scenes(/\w+(:localize|/observations))?|(POST|PATCH) /v1/uploads(/\w+)?")

MAX_BODY_BYTES = 4 * 2**20
"""Body limit of requests other than uploads, equal to that of gRPC messages."""


class OuterLayer:
    """ASGI middleware; Starlette's BaseHTTPMiddleware would hide client disconnects."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        request_id = accepted_request_id(headers.get("x-request-id", ""))
        scope.setdefault("state", {})["request_id"] = request_id
        started = time.perf_counter()
        status = 0
        ambiguity = find_ambiguity(headers, scope["http_version"])

        async def tagged_send(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                response_headers = MutableHeaders(scope=message)
                response_headers["X-Request-Id"] = request_id
                response_headers["X-Content-Type-Options"] = "nosniff"
                response_headers["Referrer-Policy"] = "no-referrer"
                if scope["scheme"] == "https":
                    response_headers["Strict-Transport-Security"] = "max-age=31536000"
                if ambiguity is not None:
                    response_headers["Connection"] = "close"
            await send(message)

        is_upload = _UPLOADS.fullmatch(f"{scope['method']} {scope['path']}") is not None
        try:
            if ambiguity is not None:
                raise ambiguity
            if len(headers.raw) > MAX_HEADERS:
                raise LimitExceededError(
                    f"{len(headers.raw)} headers",
                    field="headers",
                    limit=f"{MAX_HEADERS} header lines",
                    hint="Send only what the request needs.",
                )
            await self._app(*head_as_get(scope, receive if is_upload else _limited(receive), tagged_send))
        except asyncio.CancelledError:  # by the server, at the end of its drain time
            if status:
                raise
            stopping = NotReadyNowError("the server stops", hint="Wait a moment, then send it again.")
            await problem_response(request_id, stopping)(scope, receive, tagged_send)
        except ClientDisconnect:
            _log.info("request %s: the client went away", request_id)
        except Exception as error:
            if status:
                raise  # the answer has begun; the server closes the connection
            await problem_response(request_id, error)(scope, receive, tagged_send)
        peer = (scope.get("client") or ("",))[0]
        log_request(_log, request_id, scope["method"], scope["path"], status, started, peer)


def _limited(receive: Receive) -> Receive:
    total = 0

    async def limited_receive() -> Message:
        nonlocal total
        message = await receive()
        if message["type"] == "http.request":
            total += len(message.get("body", b""))
            if total > MAX_BODY_BYTES:
                raise BodyTooLargeError(MAX_BODY_BYTES)
        return message

    return limited_receive


def find_ambiguity(headers: Headers, http_version: str) -> InvalidInputError | None:
    """Finds ambiguous framing or a bad Host; the connection must then be closed."""
    if "transfer-encoding" in headers and "content-length" in headers:
        return InvalidInputError(
            "a request with Transfer-Encoding and Content-Length", field="content-length", hint="Send one of the two."
        )
    hosts = headers.getlist("host")
    if (http_version == "1.0" and not hosts) or (len(hosts) == 1 and _HOST.fullmatch(hosts[0])):
        return None
    return InvalidInputError(
        f"no host: {', '.join(hosts)[:80]!r}", field="host", hint="Send one Host header: a name, and a port."
    )
