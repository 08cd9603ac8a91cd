"""RPCs that are not plain request and answer: uploads, streams, waiting, photos."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import aclosing
from typing import TypeVar

from grpc import aio

from fastsplat.api.grpc.guard import Context, guarded
from fastsplat.api.grpc.standing import answer_stream
from fastsplat.api.grpc.upload import MAX_MESSAGE_BYTES, StreamSink
from fastsplat.api.operation_waits import Operations
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.codec.proto_codec import from_proto, to_proto
from fastsplat_contract.errors import CancelledError
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.messages.pieces import CHUNK_BYTES, messages_of_query
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.v1 import fastsplat_pb2 as pb

M = TypeVar("M")


class SceneServicer:
    """RPCs of `fastsplat.v1.SceneService` that stream, wait or read files."""

    def __init__(self, service: SceneService, threads: Threads) -> None:
        self._service = service
        self._threads = threads
        self._operations = Operations(service, threads)

    async def CreateScene(
        self, request_iterator: AsyncIterator[pb.CreateSceneRequest], context: Context
    ) -> pb.Operation:
        async with guarded(context, "CreateScene"):
            operation = await self._threads.receive(
                _whole(request_iterator, context),
                lambda: StreamSink(self._service),
                size=pb.CreateSceneRequest.ByteSize,
                memory_bytes=2 * MAX_MESSAGE_BYTES,  # one is written while the next arrives
            )
            return _message(operation)

    async def WaitOperation(self, request: pb.WaitOperationRequest, context: Context) -> pb.Operation:
        async with guarded(context, "WaitOperation"):
            return _message(await self._operations.wait(request.operation_id, request.timeout_s))

    async def WatchOperation(self, request: pb.WatchOperationRequest, context: Context) -> AsyncIterator[pb.Operation]:
        async with guarded(context, "WatchOperation"):
            first = await self._operations.current(request.operation_id)
            async with aclosing(self._operations.changes(first)) as changes:
                async for change in changes:
                    yield _message(change.operation)

    async def Query(self, request: pb.QueryRequest, context: Context) -> AsyncIterator[pb.QueryResponse]:
        def asked() -> list[pb.QueryResponse]:
            return list(messages_of_query(self._service.answers.query(from_proto(QueryRequest, request))))

        async with guarded(context, "Query"):
            for message in await self._threads.answer(asked, background=pb.OUTPUT_MASK2D in request.outputs):
                yield message

    async def StreamQuery(
        self, request_iterator: AsyncIterator[pb.StreamQueryRequest], context: Context
    ) -> AsyncIterator[pb.StreamQueryResponse]:
        answers = answer_stream(self._service, self._threads, aiter(request_iterator))
        async with guarded(context, "StreamQuery"), aclosing(answers):
            async for message in answers:
                yield message

    async def DownloadPhoto(self, request: pb.DownloadPhotoRequest, context: Context) -> AsyncIterator[pb.Chunk]:
        async with guarded(context, "DownloadPhoto"):
            path, _ = await self._threads.call(
                lambda: self._service.photos.path(request.scene_id, request.view, request.version)
            )
            file = await self._threads.call(lambda: path.open("rb"))
            try:
                while data := await self._threads.call(lambda: file.read(CHUNK_BYTES)):
                    yield pb.Chunk(data=data)
            finally:
                file.close()


def _message(operation: Operation) -> pb.Operation:
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
