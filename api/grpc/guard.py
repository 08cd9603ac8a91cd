"""Wrapper of every RPC: its request id, its errors as google.rpc.Status, its line in the log."""

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
    """Run an RPC's body; whatever it raises becomes the RPC's status with its details."""
    metadata = dict(context.invocation_metadata() or ())
    request_id = accepted_request_id(str(metadata.get(_KEY, "")))
    context.set_trailing_metadata(((_KEY, request_id),))
    # Before the body: once the call is gone, peer(), auth_context() and peer_identities() end the process with a
    # segmentation fault (grpcio 1.85.1).
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
    """The address in gRPC's "ipv4:127.0.0.1:4711" or "ipv6:%5B::1%5D:4711"."""
    return unquote(peer.partition(":")[2].rpartition(":")[0]).strip("[]")
