"""Responses of routes: service calls on threads, cancelled when the client disconnects."""

from __future__ import annotations

import asyncio
import gzip
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Protocol, TypeVar

from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from fastsplat.api.rest.problem_answers import PROBLEM_RESPONSE
from fastsplat.api.rest.standard_http import reads_gzip
from fastsplat_contract.codec.json_codec import to_json
from fastsplat_contract.jobs.operations import Operation

_R = TypeVar("_R")


class Run(Protocol):
    """Runs a function on a thread."""

    def __call__(self, function: Callable[[], _R], /) -> Awaitable[_R]:
        """Runs it."""


_GZIP_FROM_BYTES = 4_096
_GZIP_LEVEL = 4

PROBLEMS: dict[int | str, dict[str, Any]] = {"4XX": PROBLEM_RESPONSE, "5XX": PROBLEM_RESPONSE}
"""OpenAPI error responses of all routes."""
UNCHANGED: dict[int | str, dict[str, Any]] = {304: {"description": "the copy that If-None-Match names is the same"}}
"""OpenAPI response of conditional requests."""


def file_response(*media_types: str, description: str) -> dict[int | str, dict[str, Any]]:
    """Builds the OpenAPI response of a route that answers with a file."""
    of_json, of_bytes = {"type": "object"}, {"type": "string", "format": "binary"}
    content = {kind: {"schema": of_json if kind == "application/json" else of_bytes} for kind in media_types}
    return {200: {"content": content, "description": description}}


async def while_connected(request: Request, awaitable: Awaitable[_R], body_read: asyncio.Event | None = None) -> _R:
    """Awaits work, and cancels it, down to the rasterizer, when the client disconnects.

    Args:
        body_read: set once the work has read the whole body; until then the work itself notices a disconnect.

    Raises:
        ClientDisconnect: the client has disconnected.
    """
    work = asyncio.ensure_future(awaitable)
    disconnect = asyncio.ensure_future(_disconnect(request, body_read))
    try:
        await asyncio.wait((work, disconnect), return_when=asyncio.FIRST_COMPLETED)
        if not work.done():
            raise ClientDisconnect
        return work.result()
    finally:
        disconnect.cancel()
        work.cancel()


async def json_of_call(request: Request, run: Run, function: Callable[[], Any]) -> Response:
    """Answers with a service call's result as JSON, encoded and compressed on its thread.

    `run` is `Threads.call` or `Threads.answer`.
    """
    compress = reads_gzip(request.headers)

    def answered() -> tuple[bytes, bool]:
        body = to_json(function())
        if compress and len(body) >= _GZIP_FROM_BYTES:
            return gzip.compress(body, _GZIP_LEVEL, mtime=0), True
        return body, False

    body, compressed = await while_connected(request, run(answered))
    headers = {"Vary": "Accept-Encoding"} | ({"Content-Encoding": "gzip"} if compressed else {})
    return json_response(body, 200, headers)


def json_response(body: bytes, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    return Response(body, status, headers, "application/json")


def accepted(operation: Operation, root_path: str) -> Response:
    """Builds the 202 response of a queued job, with its Location under `root_path`."""
    return json_response(to_json(operation), 202, {"Location": f"{root_path}/v1/operations/{operation.id}"})


async def _disconnect(request: Request, body_read: asyncio.Event | None) -> None:
    if body_read is not None:
        await body_read.wait()
    while (await request.receive())["type"] != "http.disconnect":
        pass  # the rest of the body
