"""All RPCs: streams, uploads, waiting and photos by hand, the others from the table of calls."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import aclosing
from types import NoneType
from typing import Any, TypeAlias, TypeVar

import grpc
from google.protobuf import empty_pb2, message_factory
from google.protobuf.message import DecodeError, Message
from grpc import aio

from fastsplat.api.grpc.interceptors import MAKERS, Context, guarded
from fastsplat.api.grpc.subscriptions import answer_stream
from fastsplat.api.grpc.upload import MAX_MESSAGE_BYTES, StreamSink
from fastsplat.api.handlers import HANDLERS, Handler
from fastsplat.api.operation_waits import Operations
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.calls import CALLS
from fastsplat_contract.codec.proto_codec import from_proto, to_proto
from fastsplat_contract.errors import CancelledError, InvalidInputError
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.messages.pieces import CHUNK_BYTES, chunks, messages_of_query
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.v1 import fastsplat_pb2 as pb

Behavior: TypeAlias = "Callable[[Any, Context], Any]"

_SERVICE = pb.DESCRIPTOR.services_by_name["SceneService"]

M = TypeVar("M")


def add_rpcs(server: aio.Server, service: SceneService, threads: Threads) -> None:
    """Registers `fastsplat.v1.SceneService`: methods of `_SceneServicer`, else entries of `HANDLERS`."""
    written = _SceneServicer(service, threads)
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
        return await handler.run(threads, lambda: _answered(handler.ask(service, _request_of(handler, request))))

    return behavior


def _file(handler: Handler[Any, Any], service: SceneService, threads: Threads) -> Behavior:
    """Builds an RPC that answers a file in chunks."""

    async def behavior(request: Message, context: Context) -> AsyncIterator[pb.Chunk]:
        content = await handler.run(threads, lambda: handler.ask(service, _request_of(handler, request)))
        for chunk in chunks(content):
            yield pb.Chunk(data=chunk)

    return behavior


def _request_of(handler: Handler[Any, Any], message: Message) -> Any:
    return None if handler.call.request is NoneType else from_proto(handler.call.request, message)


def _answered(value: Any) -> Message:
    message: Message = empty_pb2.Empty() if value is None else to_proto(value)
    return message


def _handler(rpc: str, behavior: Behavior) -> grpc.RpcMethodHandler[Any, Any]:
    """Decodes requests here, because gRPC says UNKNOWN or INTERNAL of undecodable ones."""
    method = _SERVICE.methods_by_name[rpc]
    request, response = map(message_factory.GetMessageClass, (method.input_type, method.output_type))

    def decoded(content: bytes) -> Message:
        try:
            return request.FromString(content)
        except DecodeError:
            raise InvalidInputError(
                f"{len(content)} bytes that are no message of this call",
                field="message",
                hint="Encode requests by protos/fastsplat/v1/fastsplat.proto.",
            ) from None

    def received(sent: Any) -> Any:
        return (decoded(content) async for content in sent) if method.client_streaming else decoded(sent)

    async def unary(sent: Any, context: Context) -> Message:
        async with guarded(context, rpc):
            message: Message = await behavior(received(sent), context)
            return message

    async def many(sent: Any, context: Context) -> AsyncIterator[Message]:
        async with guarded(context, rpc), aclosing(behavior(received(sent), context)) as responses:
            async for message in responses:
                yield message

    make = MAKERS[method.client_streaming, method.server_streaming]
    return make(many if method.server_streaming else unary, None, response.SerializeToString)


class _SceneServicer:
    """RPCs of `fastsplat.v1.SceneService` that stream, wait or read files."""

    def __init__(self, service: SceneService, threads: Threads) -> None:
        self._service = service
        self._threads = threads
        self._operations = Operations(service, threads)

    async def CreateScene(
        self, request_iterator: AsyncIterator[pb.CreateSceneRequest], context: Context
    ) -> pb.Operation:
        operation = await self._threads.receive(
            _whole(request_iterator, context),
            lambda: StreamSink(self._service),
            size=pb.CreateSceneRequest.ByteSize,
            memory_bytes=2 * MAX_MESSAGE_BYTES,  # one is written while the next arrives
        )
        return _operation_message(operation)

    async def WaitOperation(self, request: pb.WaitOperationRequest, context: Context) -> pb.Operation:
        return _operation_message(await self._operations.wait(request.operation_id, request.timeout_s))

    async def WatchOperation(self, request: pb.WatchOperationRequest, context: Context) -> AsyncIterator[pb.Operation]:
        first = await self._operations.current(request.operation_id)
        async with aclosing(self._operations.changes(first)) as changes:
            async for change in changes:
                yield _operation_message(change.operation)

    async def Query(self, request: pb.QueryRequest, context: Context) -> AsyncIterator[pb.QueryResponse]:
        def messages() -> list[pb.QueryResponse]:
            return list(messages_of_query(self._service.answers.query(from_proto(QueryRequest, request))))

        for message in await self._threads.answer(messages, background=pb.OUTPUT_MASK2D in request.outputs):
            yield message

    async def StreamQuery(
        self, request_iterator: AsyncIterator[pb.StreamQueryRequest], context: Context
    ) -> AsyncIterator[pb.StreamQueryResponse]:
        answers = answer_stream(self._service, self._threads, aiter(request_iterator))
        async with aclosing(answers):
            async for message in answers:
                yield message

    async def DownloadPhoto(self, request: pb.DownloadPhotoRequest, context: Context) -> AsyncIterator[pb.Chunk]:
        path, _ = await self._threads.call(
            lambda: self._service.photos.path(request.scene_id, request.view, request.version)
        )
        file = await self._threads.call(lambda: path.open("rb"))
        try:
            while data := await self._threads.call(lambda: file.read(CHUNK_BYTES)):
                yield pb.Chunk(data=data)
        finally:
            file.close()


def _operation_message(operation: Operation) -> pb.Operation:
    message: pb.Operation = to_proto(operation)
    return message


async def _whole(messages: AsyncIterator[M], context: Context) -> AsyncIterator[M]:
    """Yields the client's messages, and raises `CancelledError` if the call was cancelled before their end.

    gRPC ends the iteration for a cancelled call as for a complete one, sometimes long before it reports the
    cancellation. Only a complete stream can still be written to, so the initial metadata are sent as a test.
    """
    async for message in messages:
        yield message
    try:
        await context.send_initial_metadata(())
    except aio.InternalError:
        raise CancelledError("the sender went away") from None
    left = context.time_remaining()
    if context.done() or (left is not None and left <= 0):
        raise CancelledError("the sender went away")
