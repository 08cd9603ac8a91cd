"""Registration of all RPCs: those of `SceneServicer`, the others from the table of calls."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from types import NoneType
from typing import Any, TypeAlias

import grpc
from google.protobuf import empty_pb2, message_factory
from google.protobuf.message import Message
from grpc import aio

from fastsplat.api.grpc.guard import Context, guarded
from fastsplat.api.grpc.servicer import SceneServicer
from fastsplat.api.handlers import HANDLERS, Handler
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.calls import CALLS
from fastsplat_contract.codec.proto_codec import from_proto, to_proto
from fastsplat_contract.messages.pieces import chunks
from fastsplat_contract.v1 import fastsplat_pb2 as pb

Behavior: TypeAlias = "Callable[[Any, Context], Any]"

_SERVICE = pb.DESCRIPTOR.services_by_name["SceneService"]


def add_rpcs(server: aio.Server, service: SceneService, threads: Threads) -> None:
    """Registers `fastsplat.v1.SceneService`: methods of `SceneServicer`, else entries of `HANDLERS`."""
    written = SceneServicer(service, threads)
    handlers = {}
    for call in CALLS:
        behavior = getattr(written, call.rpc, None)
        if behavior is None:
            handler = HANDLERS[call.rpc]
            behavior = _file(handler, service, threads) if call.pieces_out else _message(handler, service, threads)
        handlers[call.rpc] = _handler(call.rpc, behavior)
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(_SERVICE.full_name, handlers),))
    server.add_registered_method_handlers(_SERVICE.full_name, handlers)


def _message(handler: Handler[Any, Any], service: SceneService, threads: Threads) -> Behavior:
    """Builds a unary RPC; messages are converted on the thread."""

    async def behavior(request: Message, context: Context) -> Message:
        async with guarded(context, handler.call.rpc):
            return await handler.run(threads, lambda: _answered(handler.ask(service, _asked(handler, request))))

    return behavior


def _file(handler: Handler[Any, Any], service: SceneService, threads: Threads) -> Behavior:
    """Builds an RPC that answers a file in chunks."""

    async def behavior(request: Message, context: Context) -> AsyncIterator[pb.Chunk]:
        async with guarded(context, handler.call.rpc):
            content = await handler.run(threads, lambda: handler.ask(service, _asked(handler, request)))
            for chunk in chunks(content):
                yield pb.Chunk(data=chunk)

    return behavior


def _asked(handler: Handler[Any, Any], message: Message) -> Any:
    return None if handler.call.request is NoneType else from_proto(handler.call.request, message)


def _answered(value: Any) -> Message:
    message: Message = empty_pb2.Empty() if value is None else to_proto(value)
    return message


def _handler(rpc: str, behavior: Behavior) -> grpc.RpcMethodHandler[Any, Any]:
    method = _SERVICE.methods_by_name[rpc]
    make = {
        (False, False): grpc.unary_unary_rpc_method_handler,
        (False, True): grpc.unary_stream_rpc_method_handler,
        (True, False): grpc.stream_unary_rpc_method_handler,
        (True, True): grpc.stream_stream_rpc_method_handler,
    }[method.client_streaming, method.server_streaming]
    request, response = map(message_factory.GetMessageClass, (method.input_type, method.output_type))
    return make(behavior, request.FromString, response.SerializeToString)
