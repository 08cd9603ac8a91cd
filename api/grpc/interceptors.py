"""What surrounds every RPC: errors as google.rpc.Status, access log, access control."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import aclosing, asynccontextmanager
from typing import Any, TypeAlias
from urllib.parse import unquote

import grpc
from grpc import aio
from grpc_status import rpc_status

from fastsplat.api.access.access_log import log_request
from fastsplat.api.access.authenticator import Credentials, KeyWatch
from fastsplat.api.access.caller import Principal, current_principal
from fastsplat.api.access.gate import Gate
from fastsplat.api.access.policy import UNMATCHED, is_known_route, rule_of
from fastsplat.api.errors import accepted_request_id, refusal_of
from fastsplat_contract.call import Rule
from fastsplat_contract.errors import FastSplatError

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
    # "ipv4:127.0.0.1:4711" or "ipv6:%5B::1%5D:4711".
    address = unquote(context.peer().partition(":")[2].rpartition(":")[0]).strip("[]")
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


Handler: TypeAlias = "grpc.RpcMethodHandler[Any, Any]"


MAKERS = {
    (False, False): grpc.unary_unary_rpc_method_handler,
    (False, True): grpc.unary_stream_rpc_method_handler,
    (True, False): grpc.stream_unary_rpc_method_handler,
    (True, True): grpc.stream_stream_rpc_method_handler,
}
"""What makes a handler, by whether its requests and its responses are streams."""


def _replaced(handler: Handler, behavior: Callable[[Any, Context], Any]) -> Handler:
    """Copies a handler with another behavior."""
    make = MAKERS[handler.request_streaming, handler.response_streaming]
    return make(behavior, handler.request_deserializer, handler.response_serializer)


_UNKNOWN = "unknown"
_CODES = {code.value[0]: code.name for code in grpc.StatusCode}


class AccessInterceptor(aio.ServerInterceptor):
    """Interceptor that authenticates and limits RPCs before their handler runs."""

    def __init__(self, gate: Gate) -> None:
        self._gate = gate

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Handler | None]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Handler | None:
        method = str(handler_call_details.method)
        metadata = {str(name): str(value) for name, value in handler_call_details.invocation_metadata or ()}
        handler = await continuation(handler_call_details)
        rule = rule_of(method) if handler is not None else UNMATCHED
        if rule.role is None:
            return handler
        try:
            principal = await self._gate.authenticate(Credentials.of(metadata), rule)
        except FastSplatError as error:
            return _refusing(handler, method, error)
        if handler is None or principal is None:
            return handler
        return _wrapped(handler, method if is_known_route(method) else _UNKNOWN, principal, rule, self._gate)


def _wrapped(handler: Handler, route: str, principal: Principal, rule: Rule, gate: Gate) -> Handler:
    inner: Any = handler.unary_unary or handler.unary_stream or handler.stream_unary or handler.stream_stream

    @asynccontextmanager
    async def entered(context: Context) -> AsyncIterator[KeyWatch]:
        status = ""
        with gate.metrics.request(route) as ended:
            try:
                current_principal.set(principal)
                with gate.entered(principal, rule) as watch:
                    yield watch
            except FastSplatError as error:  # raised by the gate; the handler reports its own errors
                async with guarded(context, route):
                    raise error
            except (asyncio.CancelledError, aio.InternalError):  # the caller is gone; gRPC may notice only on a write
                status = "CANCELLED"
                raise
            finally:
                ended(status or _status(context))

    async def unary(request: Any, context: Context) -> Any:
        async with entered(context):
            return await inner(request, context)

    async def many(request: Any, context: Context) -> None:
        # Not a generator: gRPC would leave it to the garbage collector when its reader is gone, but it must be closed
        # in the call's own task.
        async with entered(context) as watch, aclosing(inner(request, context)) as responses:
            async for response in responses:
                with watch.deferred():  # gRPC's own code must not be cancelled
                    await context.write(response)

    return _replaced(handler, many if handler.response_streaming else unary)


def _status(context: Context) -> str:
    code: Any = context.code()
    return _CODES.get(code, "OK") if isinstance(code, int) else getattr(code, "name", "OK")


def _refusing(handler: Handler | None, method: str, error: FastSplatError) -> Handler:
    async def refuse(request: Any, context: Context) -> None:
        async with guarded(context, method):
            raise error

    return grpc.unary_unary_rpc_method_handler(refuse) if handler is None else _replaced(handler, refuse)
