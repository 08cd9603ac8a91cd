"""Wrapper of every RPC: request id, errors as google.rpc.Status, access log."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, TypeAlias
from urllib.parse import unquote

from grpc import aio
from grpc_status import rpc_status

from fastsplat.api.access.access_log import log_request
from fastsplat.api.errors import accepted_request_id, refusal_of

Context: TypeAlias = aio.ServicerContext[Any, Any]

_log = logging.getLogger(__name__)
_KEY = "x-request-id"


@asynccontextmanager
async def guarded(context: Context, rpc: str) -> AsyncIterator[None]:
    """Runs an RPC's body; its exceptions become the RPC's status with details."""
    metadata = dict(context.invocation_metadata() or ())
    request_id = accepted_request_id(str(metadata.get(_KEY, "")))
    context.set_trailing_metadata(((_KEY, request_id),))
    # Read before the body: after the call has ended, peer(), auth_context() and peer_identities() crash the process
    # with a segmentation fault (grpcio 1.85.1).
    address = _address(context.peer())
    started = time.perf_counter()
    outcome = "OK"
    try:
        yield
    except (asyncio.CancelledError, GeneratorExit):
        outcome = "CANCELLED"
        raise
    except Exception as error:
        refusal = refusal_of(error, request_id)
        outcome = refusal.status.grpc.name
        await context.abort_with_status(rpc_status.to_status(refusal.as_rpc_status()))
    finally:
        log_request(_log, request_id, "gRPC", rpc, outcome, started, address)


def _address(peer: str) -> str:
    """Extracts the address from "ipv4:127.0.0.1:4711" or "ipv6:%5B::1%5D:4711"."""
    return unquote(peer.partition(":")[2].rpartition(":")[0]).strip("[]")
