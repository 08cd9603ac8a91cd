"""Reports gRPC decoding errors as INVALID_INPUT; gRPC itself answers UNKNOWN or INTERNAL."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import aclosing
from dataclasses import dataclass
from typing import Any, TypeAlias

import grpc
from google.protobuf.message import DecodeError
from grpc import aio

from fastsplat.api.grpc.guard import Context, guarded
from fastsplat_contract.errors import InvalidInputError

Handler: TypeAlias = "grpc.RpcMethodHandler[Any, Any]"


@dataclass(frozen=True)
class _Unreadable:
    """Placeholder for a message that could not be decoded."""

    size: int


class DecodingInterceptor(aio.ServerInterceptor):
    """Interceptor that refuses undecodable messages, in streams too, with INVALID_INPUT."""

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Handler | None]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Handler | None:
        handler = await continuation(handler_call_details)
        if handler is None or handler.request_deserializer is None:
            return handler
        behavior = wrapped_behavior(handler)
        method = str(handler_call_details.method)

        async def unary(request: Any, context: Context) -> Any:
            return await behavior(await _checked(request, context, method), context)

        async def many(request: Any, context: Context) -> AsyncIterator[Any]:
            async with aclosing(behavior(await _checked(request, context, method), context)) as responses:
                async for response in responses:
                    yield response

        return replaced(handler, many if handler.response_streaming else unary, _decoder(handler.request_deserializer))


def wrapped_behavior(handler: Handler) -> Callable[[Any, Context], Any]:
    """Returns the function that a handler calls with its request(s) and context."""
    behavior: Any
    if handler.request_streaming:
        behavior = handler.stream_stream if handler.response_streaming else handler.stream_unary
    else:
        behavior = handler.unary_stream if handler.response_streaming else handler.unary_unary
    function: Callable[[Any, Context], Any] = behavior
    return function


def replaced(
    handler: Handler, behavior: Callable[[Any, Context], Any], decoder: Callable[[bytes], Any] | None = None
) -> Handler:
    """Copies a handler with another behavior and, if given, another decoder."""
    make = {
        (False, False): grpc.unary_unary_rpc_method_handler,
        (False, True): grpc.unary_stream_rpc_method_handler,
        (True, False): grpc.stream_unary_rpc_method_handler,
        (True, True): grpc.stream_stream_rpc_method_handler,
    }[handler.request_streaming, handler.response_streaming]
    return make(behavior, decoder or handler.request_deserializer, handler.response_serializer)


async def _checked(request: Any, context: Context, method: str) -> Any:
    if isinstance(request, _Unreadable):
        async with guarded(context, method):  # aborts with the error's status
            raise _refusal(request)
    return _readable(request) if hasattr(request, "__aiter__") else request


async def _readable(requests: AsyncIterator[Any]) -> AsyncIterator[Any]:
    async for request in requests:
        if isinstance(request, _Unreadable):
            raise _refusal(request)
        yield request


def _refusal(message: _Unreadable) -> InvalidInputError:
    return InvalidInputError(
        f"{message.size} bytes that are no message of this call",
        field="message",
        hint="Encode requests by protos/fastsplat/v1/fastsplat.proto.",
    )


def _decoder(decode: Callable[[bytes], Any]) -> Callable[[bytes], Any]:
    def decoded(content: bytes) -> Any:
        try:
            return decode(content)
        except DecodeError:
            return _Unreadable(len(content))

    return decoded
