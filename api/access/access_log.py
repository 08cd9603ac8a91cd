"""Access log: one line per request."""

from __future__ import annotations

import logging
import time

from fastsplat.api.access.caller import caller_id

_MAX_CHARS = 200


def log_request(
    log: logging.Logger, request_id: str, method: str, path: str, status: int | str, started: float, peer: str
) -> None:
    """Logs caller, request, outcome and duration; never headers, query strings or bodies.

    Args:
        method: the HTTP method, or "gRPC".
        path: the path without its query string, or the RPC.
        status: HTTP status number or gRPC status name.
        started: `time.perf_counter()` at arrival.
        peer: the caller's address; behind a trusted proxy, the one that it forwards.
    """
    milliseconds = round(1000 * (time.perf_counter() - started), 1)
    log.info(
        "%s %s %s",
        method,
        path[:_MAX_CHARS],
        status,
        extra={
            "request_id": request_id,
            "method": method,
            "path": path[:_MAX_CHARS],
            "status": status,
            "milliseconds": milliseconds,
            "key_id": caller_id(),
            "peer": peer,
        },
    )
