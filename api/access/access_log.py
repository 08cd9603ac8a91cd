"""The access log: one line a request."""

from __future__ import annotations

import logging
import time

from fastsplat.api.access.caller import caller_id

_MAX_CHARS = 200


def log_request(
    log: logging.Logger, request_id: str, method: str, path: str, status: int | str, started: float, peer: str
) -> None:
    """One record: who asked for what, the outcome, how long it took. Never a header, a query string or a body.

    Args:
        log: the protocol's logger.
        request_id: as the answer carries it.
        method: HTTP's, or "gRPC".
        path: without its query string, or the RPC.
        status: HTTP's number or gRPC's name.
        started: `time.perf_counter()` when the request came.
        peer: address of the caller; of one behind a trusted proxy, what the proxy says.
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
