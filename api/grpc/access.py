"""Access control of gRPC: an interceptor for all RPCs, streams included."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import aclosing, asynccontextmanager
from typing import Any, TypeAlias

import grpc
from grpc import aio

from fastsplat.api.access.authenticator import Credentials, KeyWatch
from fastsplat.api.access.caller import Principal, current_principal
from fastsplat.api.access.gate import Gate
from fastsplat.api.access.policy import UNMATCHED, is_known_route, rule_of
from fastsplat.api.grpc.decoding import replaced, wrapped_behavior
from fastsplat.api.grpc.guard import Context, guarded
from fastsplat_contract.call import Rule
from fastsplat_contract.errors import FastSplatError

Handler: TypeAlias = "grpc.RpcMethodHandler[Any, Any]"

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
    inner = wrapped_behavior(handler)

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

    return replaced(handler, many if handler.response_streaming else unary)


def _status(context: Context) -> str:
    code: Any = context.code()
    return _CODES.get(code, "OK") if isinstance(code, int) else getattr(code, "name", "OK")


def _refusing(handler: Handler | None, method: str, error: FastSplatError) -> Handler:
    async def refuse(request: Any, context: Context) -> None:
        async with guarded(context, method):
            raise error

    return grpc.unary_unary_rpc_method_handler(refuse) if handler is None else replaced(handler, refuse)
