"""What every route does: one service call on a thread, dropped when the client goes away."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from fastsplat.api.rest.problem_answers import PROBLEM_RESPONSE
from fastsplat.api.threads import Threads
from fastsplat_contract.json_codec import to_json

_R = TypeVar("_R")

PROBLEMS: dict[int | str, dict[str, Any]] = {"4XX": PROBLEM_RESPONSE, "5XX": PROBLEM_RESPONSE}
"""What OpenAPI says of every route's errors."""


def file_response(*media_types: str, description: str) -> dict[int | str, dict[str, Any]]:
    """What OpenAPI says of a route that answers with bytes."""
    schema = {"type": "string", "format": "binary"}
    content = {media_type: {"schema": schema} for media_type in media_types}
    return {200: {"content": content, "description": description}}


async def called(request: Request, threads: Threads, function: Callable[[], _R]) -> _R:
    """The call's result; when the client closes the connection, the call is cancelled down to the rasterizer.

    Raises:
        ClientDisconnect: nobody waits for the result any more.
    """
    work = asyncio.ensure_future(threads.call(function))
    gone = asyncio.ensure_future(_gone(request))
    try:
        await asyncio.wait((work, gone), return_when=asyncio.FIRST_COMPLETED)
        if not work.done():
            raise ClientDisconnect
        return work.result()
    finally:
        gone.cancel()
        work.cancel()


async def answered(request: Request, threads: Threads, function: Callable[[], object]) -> Response:
    """Call, and write the contract's JSON, on the thread: a large answer must not hold up the event loop."""
    return json_response(await called(request, threads, lambda: to_json(function())))


def json_response(body: bytes, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    """JSON that is written already."""
    return Response(body, status, headers, "application/json")


async def _gone(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass  # what is left of the body
