"""Who may come in over gRPC: every RPC passes here before its handler, streams included."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any, TypeAlias

import grpc
from grpc import aio

from fastsplat.api.auth import Principal, Rule, current_principal, decided, rule_of, sent_key
from fastsplat.api.doors import Doors
from fastsplat.api.grpc.guard import Context, guarded
from fastsplat.api.limits import Entry
from fastsplat_contract.errors import FastSplatError

Handler: TypeAlias = "grpc.RpcMethodHandler[Any, Any]"

_UNKNOWN = "unknown"
_CODES = {code.value[0]: code.name for code in grpc.StatusCode}


class AccessInterceptor(aio.ServerInterceptor):
    """Asks the doorkeeper and the limiter, then runs the handler."""

    def __init__(self, doors: Doors) -> None:
        self._doors = doors

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Handler | None]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Handler | None:
        """Hand out the handler, wrapped; or one that refuses."""
        method = str(handler_call_details.method)
        rule = rule_of(method)
        metadata = {str(name): value for name, value in handler_call_details.invocation_metadata or ()}
        key = sent_key(str(metadata.get("authorization", "")), str(metadata.get("x-api-key", "")))
        handler = await continuation(handler_call_details)
        if rule.need == "open" and handler is not None:
            return handler
        try:
            principal = await self._doors.admit(key, rule)
        except FastSplatError as error:
            return _refusing(handler, method, error)
        if handler is None or principal is None:
            return handler
        return _wrapped(handler, method if decided(method) else _UNKNOWN, principal, rule, self._doors)


def _wrapped(handler: Handler, route: str, principal: Principal, rule: Rule, doors: Doors) -> Handler:
    inner = _behaviour(handler)

    async def entry(context: Context) -> Entry:
        current_principal.set(principal)
        try:
            return doors.enter(principal, rule)
        except FastSplatError as error:
            async with guarded(context, route):  # aborts with the error's status
                raise error
            raise AssertionError from error

    async def one(request: Any, context: Context) -> Any:
        with doors.metrics.request(route) as ended:
            try:
                came_in = await entry(context)
                try:
                    return await inner(request, context)
                finally:
                    came_in.leave()
            finally:
                ended(_status(context))

    async def many(request: Any, context: Context) -> AsyncIterator[Any]:
        with doors.metrics.request(route) as ended:
            try:
                came_in = await entry(context)
                try:
                    async for response in inner(request, context):
                        yield response
                finally:
                    came_in.leave()
            finally:
                ended(_status(context))

    return _like(handler, many if handler.response_streaming else one)


def _status(context: Context) -> str:
    if context.cancelled():
        return "CANCELLED"
    code: Any = context.code()
    return _CODES.get(code, "OK") if isinstance(code, int) else getattr(code, "name", "OK")


def _refusing(handler: Handler | None, method: str, error: FastSplatError) -> Handler:
    async def one(request: Any, context: Context) -> Any:
        async with guarded(context, method):
            raise error

    async def many(request: Any, context: Context) -> AsyncIterator[Any]:
        async with guarded(context, method):
            raise error
        yield  # makes this a generator

    if handler is None:
        return grpc.unary_unary_rpc_method_handler(one)
    return _like(handler, many if handler.response_streaming else one)


def _behaviour(handler: Handler) -> Callable[[Any, Context], Any]:
    found: Any
    if handler.request_streaming:
        found = handler.stream_stream if handler.response_streaming else handler.stream_unary
    else:
        found = handler.unary_stream if handler.response_streaming else handler.unary_unary
    behaviour: Callable[[Any, Context], Any] = found
    return behaviour


def _like(handler: Handler, behaviour: Callable[[Any, Context], Any]) -> Handler:
    """`behaviour` in the place of the handler's own."""
    make = {
        (False, False): grpc.unary_unary_rpc_method_handler,
        (False, True): grpc.unary_stream_rpc_method_handler,
        (True, False): grpc.stream_unary_rpc_method_handler,
        (True, True): grpc.stream_stream_rpc_method_handler,
    }[handler.request_streaming, handler.response_streaming]
    return make(behaviour, handler.request_deserializer, handler.response_serializer)
