"""An operation as server-sent events (WHATWG HTML, section 9.2)."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import replace

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from fastsplat_contract.json_codec import to_json
from fastsplat_contract.operations import Operation

MEDIA_TYPE = "text/event-stream"
EVENT_SCHEMA = {
    "type": "object",
    "properties": {
        "id": {"type": "string", "description": "send it as Last-Event-ID to continue after this event"},
        "event": {"const": "operation"},
        "data": {"type": "string", "description": "an Operation as JSON"},
    },
    "required": ["id", "event", "data"],
}
"""What OpenAPI says of one event."""
_POLL_S = 0.25
_COMMENT_S = 15.0


async def operation_events(request: Request, look: Callable[[], Awaitable[Operation]]) -> Response:
    """The operation now and on every change, one event `operation` each, until it is done.

    An event's id names the state it tells, so that `Last-Event-ID` continues after it: what has not changed since is
    not told again, and after a final state there is nothing more (204, on which an EventSource stops).
    """
    known = request.headers.get("last-event-id", "")
    first = await look()
    if first.done and known == _id(first):
        return Response(status_code=204)
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(_events(first, known, look), media_type=MEDIA_TYPE, headers=headers)


async def _events(operation: Operation, known: str, look: Callable[[], Awaitable[Operation]]) -> AsyncIterator[str]:
    silent = 0.0
    while True:
        if (name := _id(operation)) != known:
            known, silent = name, 0.0
            yield f"id: {name}\nevent: operation\ndata: {to_json(operation).decode()}\n\n"
        if operation.done:
            return
        if silent >= _COMMENT_S:  # keeps proxies from closing, and finds out whether anybody listens
            silent = 0.0
            yield ": still here\n\n"
        await asyncio.sleep(_POLL_S)
        silent += _POLL_S
        operation = await look()


def _id(operation: Operation) -> str:
    # A running stage's seconds count by themselves; they are told with the next change.
    timeless = replace(operation, stages=tuple(replace(stage, seconds=0.0) for stage in operation.stages))
    return hashlib.sha256(to_json(timeless)).hexdigest()[:16]
