"""Operations as server-sent events (WHATWG HTML, section 9.2)."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import aclosing, suppress

from sse_starlette import EventSourceResponse, ServerSentEvent
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Scope, Send

from fastsplat.api.operation_waits import Operations
from fastsplat.api.rest.problem_answers import problem_document
from fastsplat_contract.codec.json_codec import to_json

MEDIA_TYPE = "text/event-stream"
EVENT_SCHEMA = {
    "type": "object",
    "properties": {
        "id": {"type": "string", "description": "send it as Last-Event-ID to continue after this event"},
        "event": {"enum": ["operation", "error"], "description": "error: the stream ends before the operation is done"},
        "data": {"type": "string", "description": "an Operation as JSON; with the event error a Problem"},
    },
    "required": ["event", "data"],
}
"""OpenAPI schema of one event."""
_COMMENT_INTERVAL_S = 15
_SEND_TIMEOUT_S = 60.0
_SEPARATOR = "\n"


async def operation_events(request: Request, operations: Operations, operation_id: str) -> Response:
    """Streams the operation, an event `operation` now and per change, until it is done.

    An event's id identifies its state, so that `Last-Event-ID` continues after it; after a final state the answer is
    204, on which an EventSource stops. A comment every 15 s keeps proxies from closing the connection; a client that
    reads nothing for 60 s is disconnected. A failure of the stream is sent as a last event `error` with the problem.
    """
    last_id = request.headers.get("last-event-id", "")
    first = await operations.current(operation_id)
    if first.operation.done and first.id == last_id:
        return Response(status_code=204)

    async def events() -> AsyncIterator[ServerSentEvent]:
        async with aclosing(operations.changes(first, last_id)) as changes:
            try:
                async for change in changes:
                    yield ServerSentEvent(id=change.id, event="operation", data=to_json(change.operation).decode())
            except Exception as error:  # the status has been sent
                yield _error_event(request.state.request_id, error)

    request.state.sends_events = True
    return EventSourceResponse(events(), ping=_COMMENT_INTERVAL_S, sep=_SEPARATOR, send_timeout=_SEND_TIMEOUT_S)


async def end_events(scope: Scope, send: Send, error: Exception) -> None:
    """Ends an interrupted answer of `operation_events` with an error event; does nothing to other answers."""
    state = scope.get("state", {})
    if not state.get("sends_events"):
        return
    body = _error_event(state["request_id"], error).encode()
    with suppress(TimeoutError):
        async with asyncio.timeout(_SEND_TIMEOUT_S):
            await send({"type": "http.response.body", "body": body, "more_body": False})


def _error_event(request_id: str, error: Exception) -> ServerSentEvent:
    return ServerSentEvent(event="error", data=problem_document(request_id, error), sep=_SEPARATOR)
