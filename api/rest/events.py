"""An operation as server-sent events (WHATWG HTML, section 9.2)."""

from __future__ import annotations

from collections.abc import AsyncIterator

from sse_starlette import EventSourceResponse, ServerSentEvent
from starlette.requests import Request
from starlette.responses import Response

from fastsplat.api.operation_waits import Operations
from fastsplat_contract.json_codec import to_json

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
_COMMENT_INTERVAL_S = 15
_SEND_TIMEOUT_S = 60.0


async def operation_events(request: Request, operations: Operations, operation_id: str) -> Response:
    """The operation now and on every change, one event `operation` each, until it is done.

    An event's id names its state, so that `Last-Event-ID` continues after it: what has not changed since is not sent
    again, and after a final state there is nothing more (204, on which an EventSource stops). A comment every 15 s
    keeps proxies from closing; a client that reads nothing for a minute is disconnected.
    """
    last_id = request.headers.get("last-event-id", "")
    first = await operations.current(operation_id)
    if first.operation.done and first.id == last_id:
        return Response(status_code=204)

    async def events() -> AsyncIterator[ServerSentEvent]:
        async for change in operations.changes(first, last_id):
            yield ServerSentEvent(id=change.id, event="operation", data=to_json(change.operation).decode())

    return EventSourceResponse(events(), ping=_COMMENT_INTERVAL_S, sep="\n", send_timeout=_SEND_TIMEOUT_S)
