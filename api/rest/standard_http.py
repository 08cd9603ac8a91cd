"""Standard HTTP: HEAD for all GET routes, ETags of computed answers, gzip negotiation."""

from __future__ import annotations

import hashlib
import re
from importlib.metadata import version

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Message, Receive, Scope, Send

_GZIP_REFUSED = re.compile(r"gzip\s*;\s*q\s*=\s*0(?:\.0*)?\s*(?:,|$)", re.IGNORECASE)
_OWN_HEAD = re.compile(r"/v1/uploads(/|$)")  # tus defines its own HEAD


def head_as_get(scope: Scope, receive: Receive, send: Send) -> tuple[Scope, Receive, Send]:
    """Turns a HEAD request into a GET whose body is not sent (RFC 9110, section 9.3.2)."""
    if scope["method"] != "HEAD" or _OWN_HEAD.match(scope["path"]):
        return scope, receive, send
    over = False

    async def send_head(message: Message) -> None:
        nonlocal over
        if message["type"] == "http.response.start":
            await send(message)
            await send({"type": "http.response.body", "body": b""})
            over = True

    async def receive_until_over() -> Message:
        return {"type": "http.disconnect"} if over else await receive()

    return {**scope, "method": "GET"}, receive_until_over, send_head


def reads_gzip(headers: Headers) -> bool:
    """Returns True if the client accepts gzip (RFC 9110, section 12.5.3)."""
    accepted = headers.get("accept-encoding", "")
    return "gzip" in accepted.lower() and _GZIP_REFUSED.search(accepted) is None


def etag_of(*parts: object) -> str:
    """Computes the ETag of an answer that depends only on `parts` and this release."""
    return f'"{hashlib.sha256(repr((version("fastsplat"), *parts)).encode()).hexdigest()[:32]}"'


def not_modified(request: Request, headers: dict[str, str]) -> Response | None:
    """Returns a 304 response if If-None-Match has the ETag of `headers`, else None."""
    tags = {part.strip().removeprefix("W/") for part in request.headers.get("if-none-match", "").split(",")}
    return Response(status_code=304, headers=headers) if tags & {headers["ETag"].removeprefix("W/"), "*"} else None
