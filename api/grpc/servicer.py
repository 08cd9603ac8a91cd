"""The RPCs; each is one service call on a thread."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

from google.protobuf import empty_pb2

from api.grpc.guard import Context, guarded
from api.grpc.translate import CHUNK_BYTES, answer_out, chunks, operation_out, picture_in, query_in, scene_out
from api.grpc.upload import receive_scene
from api.threads import Threads
from fastsplat.v1 import fastsplat_pb2 as pb
from fastsplat.v1 import fastsplat_pb2_grpc as pb_grpc
from service.calls.service import SceneService
from service.calls.types import QueryAnswer
from service.common.errors import InvalidInputError

_POLL_S = 0.25


class SceneServicer(pb_grpc.SceneServiceServicer):
    """`fastsplat.v1.SceneService` over the service layer; the contract is in the proto."""

    def __init__(self, service: SceneService, threads: Threads) -> None:
        self._service = service
        self._threads = threads

    async def CreateScene(  # noqa: N802
        self, request_iterator: AsyncIterator[pb.CreateSceneRequest], context: Context
    ) -> pb.Operation:
        """Upload a capture and queue its training."""
        async with guarded(context, "CreateScene"):
            operation = await self._threads.consume(
                aiter(request_iterator), lambda messages: receive_scene(self._service, messages)
            )
            return operation_out(operation)

    async def GetScene(self, request: pb.GetSceneRequest, context: Context) -> pb.Scene:  # noqa: N802
        """One scene in full."""
        async with guarded(context, "GetScene"):
            return await self._threads.call(lambda: scene_out(self._service.get_scene(request.scene_id), full=True))

    async def ListScenes(self, request: pb.ListScenesRequest, context: Context) -> pb.ListScenesResponse:  # noqa: N802
        """Scenes in pages."""

        def listed() -> pb.ListScenesResponse:
            page, token = self._service.list_scenes(request.page_size, request.page_token)
            scenes = [scene_out(scene, full=False) for scene in page]
            return pb.ListScenesResponse(scenes=scenes, next_page_token=token)

        async with guarded(context, "ListScenes"):
            return await self._threads.call(listed)

    async def DeleteScene(self, request: pb.DeleteSceneRequest, context: Context) -> empty_pb2.Empty:  # noqa: N802
        """Forget a scene."""
        async with guarded(context, "DeleteScene"):
            await self._threads.call(lambda: self._service.delete_scene(request.scene_id))
            return empty_pb2.Empty()

    async def GetOperation(self, request: pb.GetOperationRequest, context: Context) -> pb.Operation:  # noqa: N802
        """Where a job stands."""
        async with guarded(context, "GetOperation"):
            return await self._operation(request.operation_id)

    async def CancelOperation(self, request: pb.CancelOperationRequest, context: Context) -> pb.Operation:  # noqa: N802
        """Ask a job to stop."""
        async with guarded(context, "CancelOperation"):
            return operation_out(await self._threads.call(lambda: self._service.cancel_operation(request.operation_id)))

    async def WatchOperation(  # noqa: N802
        self, request: pb.WatchOperationRequest, context: Context
    ) -> AsyncIterator[pb.Operation]:
        """The operation now and on every change, until it is done."""
        async with guarded(context, "WatchOperation"):
            sent: pb.Operation | None = None
            while sent is None or not sent.done:
                operation = await self._operation(request.operation_id)
                if operation != sent:
                    yield operation
                    sent = operation
                if not operation.done:
                    await asyncio.sleep(_POLL_S)

    async def Query(self, request: pb.QueryRequest, context: Context) -> AsyncIterator[pb.QueryResponse]:  # noqa: N802
        """Ranked labels and masks."""
        async with guarded(context, "Query"):
            for message in await self._threads.call(lambda: [*map(answer_out, self._asked(request))]):
                for part in message:
                    yield part

    async def RenderView(self, request: pb.RenderViewRequest, context: Context) -> AsyncIterator[pb.Chunk]:  # noqa: N802
        """One PNG picture."""

        def rendered() -> bytes:
            kind, camera, view = picture_in(request)
            return self._service.view_picture(request.scene_id, request.text or None, kind, camera, view)

        async with guarded(context, "RenderView"):
            for chunk in chunks(await self._threads.call(rendered)):
                yield pb.Chunk(data=chunk)

    async def DownloadScenePly(  # noqa: N802
        self, request: pb.DownloadScenePlyRequest, context: Context
    ) -> AsyncIterator[pb.Chunk]:
        """The whole scene as a 3DGS PLY."""
        async with guarded(context, "DownloadScenePly"):
            path = await self._threads.call(lambda: self._service.scene_ply(request.scene_id))
            async for chunk in self._file(path):
                yield chunk

    async def DownloadMaskPly(  # noqa: N802
        self, request: pb.DownloadMaskPlyRequest, context: Context
    ) -> AsyncIterator[pb.Chunk]:
        """The Gaussians that answer a text as a 3DGS PLY."""
        async with guarded(context, "DownloadMaskPly"):
            ply = await self._threads.call(lambda: self._service.mask_ply(request.scene_id, request.text))
            for chunk in chunks(ply):
                yield pb.Chunk(data=chunk)

    async def _operation(self, operation_id: str) -> pb.Operation:
        return operation_out(await self._threads.call(lambda: self._service.get_operation(operation_id)))

    def _asked(self, request: pb.QueryRequest) -> tuple[QueryAnswer, ...]:
        query = query_in(request)
        if query.scene_id:
            return self._service.query(query)
        if query.cameras or query.views:
            raise InvalidInputError(
                "cameras and views belong to one scene", field="scene_id", hint="Name the scene to ask."
            )
        return self._service.query_all(query.texts, query.outputs)

    async def _file(self, path: Path) -> AsyncIterator[pb.Chunk]:
        file = await self._threads.call(lambda: path.open("rb"))
        try:
            while data := await self._threads.call(lambda: file.read(CHUNK_BYTES)):
                yield pb.Chunk(data=data)
        finally:
            file.close()
