"""The RPCs; each is one service call on a thread."""

from __future__ import annotations

from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing
from pathlib import Path
from typing import TypeVar

from google.protobuf import empty_pb2
from grpc import aio

from fastsplat.api.access.caller import caller_id
from fastsplat.api.grpc.admin_rpcs import AdminServicer
from fastsplat.api.grpc.guard import Context, guarded
from fastsplat.api.grpc.improving_rpcs import ImprovingServicer
from fastsplat.api.grpc.job_rpcs import JobServicer
from fastsplat.api.grpc.messages import as_message
from fastsplat.api.grpc.standing import answer_stream
from fastsplat.api.grpc.upload import MAX_MESSAGE_BYTES, StreamSink
from fastsplat.api.operation_waits import Operations
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.errors import CancelledError, InvalidInputError, SceneFileError
from fastsplat_contract.exports import ExportRequest
from fastsplat_contract.look_again_messages import LookAgainIn
from fastsplat_contract.measure_messages import MeasureRequest
from fastsplat_contract.operations import ListOperations, OperationList
from fastsplat_contract.pieces import CHUNK_BYTES, READS_SKIPPED, chunks, messages_of_query
from fastsplat_contract.proto_codec import from_proto
from fastsplat_contract.queries import CameraFileRequest, PictureRequest, QueryOut, QueryRequest
from fastsplat_contract.scenes import EditIn, SceneUpdate, SceneVersion, VersionList
from fastsplat_contract.thing_messages import PickRequest
from fastsplat_contract.v1 import fastsplat_pb2 as pb

M = TypeVar("M")


class SceneServicer(AdminServicer, JobServicer, ImprovingServicer):
    """`fastsplat.v1.SceneService` over the service layer; the contract is in the proto."""

    def __init__(self, service: SceneService, threads: Threads) -> None:
        self._service = service
        self._threads = threads
        self._operations = Operations(service, threads)

    async def CreateScene(
        self, request_iterator: AsyncIterator[pb.CreateSceneRequest], context: Context
    ) -> pb.Operation:
        """Upload a capture and queue its training."""
        async with guarded(context, "CreateScene"):
            operation = await self._threads.receive(
                _whole(request_iterator, context),
                StreamSink(self._service),
                size=pb.CreateSceneRequest.ByteSize,
                memory_bytes=2 * MAX_MESSAGE_BYTES,  # one is written while the next comes in
            )
            return as_message(pb.Operation, operation)

    async def GetScene(self, request: pb.GetSceneRequest, context: Context) -> pb.Scene:
        """One scene in full."""
        async with guarded(context, "GetScene"):
            return await self._message(pb.Scene, lambda: self._service.get_scene(request.scene_id))

    async def ListScenes(self, request: pb.ListScenesRequest, context: Context) -> pb.ListScenesResponse:
        """Scenes in pages."""
        async with guarded(context, "ListScenes"):
            return await self._message(
                pb.ListScenesResponse, lambda: self._service.list_scenes(request.page_size, request.page_token)
            )

    async def UpdateScene(self, request: pb.UpdateSceneRequest, context: Context) -> pb.Scene:
        """Rename a scene."""
        async with guarded(context, "UpdateScene"):
            return await self._message(
                pb.Scene, lambda: self._service.update_scene(request.scene_id, from_proto(SceneUpdate, request))
            )

    async def DeleteScene(self, request: pb.DeleteSceneRequest, context: Context) -> empty_pb2.Empty:
        """Forget a scene."""
        async with guarded(context, "DeleteScene"):
            await self._threads.call(lambda: self._service.delete_scene(request.scene_id))
            return empty_pb2.Empty()

    async def ListLabels(self, request: pb.ListLabelsRequest, context: Context) -> pb.ListLabelsResponse:
        """The dictionary in pages."""
        async with guarded(context, "ListLabels"):
            return await self._message(
                pb.ListLabelsResponse,
                lambda: self._service.list_labels(request.scene_id, request.page_size, request.page_token),
            )

    async def ListPhotoVerdicts(
        self, request: pb.ListPhotoVerdictsRequest, context: Context
    ) -> pb.ListPhotoVerdictsResponse:
        """What became of each photo, in pages."""
        async with guarded(context, "ListPhotoVerdicts"):
            return await self._message(
                pb.ListPhotoVerdictsResponse,
                lambda: self._service.list_photo_verdicts(request.scene_id, request.page_size, request.page_token),
            )

    async def ListObjects(self, request: pb.ListObjectsRequest, context: Context) -> pb.ListObjectsResponse:
        """The things of a scene in pages."""
        async with guarded(context, "ListObjects"):
            return await self._message(
                pb.ListObjectsResponse,
                lambda: self._service.answers.list_objects(
                    request.scene_id, request.version, request.label, request.page_size, request.page_token
                ),
            )

    async def ListThings(self, request: pb.ListThingsRequest, context: Context) -> pb.ListThingsResponse:
        """Every thing of a scene in pages."""
        async with guarded(context, "ListThings"):
            return await self._message(
                pb.ListThingsResponse,
                lambda: self._service.answers.list_things(
                    request.scene_id, request.version, request.page_size, request.page_token, request.parts
                ),
            )

    async def PickThing(self, request: pb.PickThingRequest, context: Context) -> pb.PickedThing:
        """The thing at a place."""
        async with guarded(context, "PickThing"):
            return await self._answer(
                pb.PickedThing, lambda: self._service.answers.pick(from_proto(PickRequest, request))
            )

    async def MeasureScene(self, request: pb.MeasureRequest, context: Context) -> pb.Measurement:
        """What is between two places."""
        async with guarded(context, "MeasureScene"):
            return await self._answer(
                pb.Measurement, lambda: self._service.answers.measure(from_proto(MeasureRequest, request))
            )

    async def EditScene(self, request: pb.EditSceneRequest, context: Context) -> pb.SceneVersion:
        """Make a new version."""

        def edited() -> SceneVersion:
            body = from_proto(EditIn, request)
            return self._service.versions.edit(request.scene_id, body.edits, body.request_id, body.version, caller_id())

        async with guarded(context, "EditScene"):
            return await self._message(pb.SceneVersion, edited)

    async def LookAgain(self, request: pb.LookAgainRequest, context: Context) -> pb.Operation:
        """Search a scene for more names."""
        async with guarded(context, "LookAgain"):
            return await self._message(
                pb.Operation, lambda: self._service.look_again(request.scene_id, from_proto(LookAgainIn, request))
            )

    async def UndoEdit(self, request: pb.UndoEditRequest, context: Context) -> pb.SceneVersion:
        """Go back one version."""
        async with guarded(context, "UndoEdit"):
            return await self._message(
                pb.SceneVersion, lambda: self._service.versions.undo(request.scene_id, request.version)
            )

    async def RedoEdit(self, request: pb.RedoEditRequest, context: Context) -> pb.SceneVersion:
        """Go forward one version."""
        async with guarded(context, "RedoEdit"):
            return await self._message(
                pb.SceneVersion, lambda: self._service.versions.redo(request.scene_id, request.version)
            )

    async def RestoreVersion(self, request: pb.RestoreVersionRequest, context: Context) -> pb.SceneVersion:
        """Make any version current."""
        async with guarded(context, "RestoreVersion"):
            return await self._message(
                pb.SceneVersion,
                lambda: self._service.versions.restore(request.scene_id, request.version, request.expected),
            )

    async def ListVersions(self, request: pb.ListVersionsRequest, context: Context) -> pb.ListVersionsResponse:
        """Every version."""
        async with guarded(context, "ListVersions"):
            return await self._message(
                pb.ListVersionsResponse, lambda: VersionList(self._service.versions.all(request.scene_id))
            )

    async def GetOperation(self, request: pb.GetOperationRequest, context: Context) -> pb.Operation:
        """Where a job stands."""
        async with guarded(context, "GetOperation"):
            return as_message(pb.Operation, await self._operations.get(request.operation_id))

    async def ListOperations(self, request: pb.ListOperationsRequest, context: Context) -> pb.ListOperationsResponse:
        """Operations in pages."""

        def listed() -> OperationList:
            return self._service.list_operations(**vars(from_proto(ListOperations, request)))

        async with guarded(context, "ListOperations"):
            return await self._message(pb.ListOperationsResponse, listed)

    async def CancelOperation(self, request: pb.CancelOperationRequest, context: Context) -> pb.Operation:
        """Ask a job to stop."""
        async with guarded(context, "CancelOperation"):
            return await self._message(pb.Operation, lambda: self._service.cancel_operation(request.operation_id))

    async def RetryOperation(self, request: pb.RetryOperationRequest, context: Context) -> pb.Operation:
        """Queue a failed or cancelled job again."""
        async with guarded(context, "RetryOperation"):
            exclude = tuple(request.exclude)
            return await self._message(
                pb.Operation, lambda: self._service.retry_operation(request.operation_id, exclude)
            )

    async def WaitOperation(self, request: pb.WaitOperationRequest, context: Context) -> pb.Operation:
        """The operation when it is done, or when the time is up."""
        async with guarded(context, "WaitOperation"):
            return as_message(pb.Operation, await self._operations.wait(request.operation_id, request.timeout_s))

    async def WatchOperation(self, request: pb.WatchOperationRequest, context: Context) -> AsyncIterator[pb.Operation]:
        """The operation now and on every change, until it is done."""
        async with guarded(context, "WatchOperation"):
            first = await self._operations.current(request.operation_id)
            async with aclosing(self._operations.changes(first)) as changes:
                async for change in changes:
                    yield as_message(pb.Operation, change.operation)

    async def Query(self, request: pb.QueryRequest, context: Context) -> AsyncIterator[pb.QueryResponse]:
        """Ranked labels, masks and objects."""

        reads_skipped = READS_SKIPPED in [tuple(entry) for entry in context.invocation_metadata() or ()]

        def asked() -> list[pb.QueryResponse]:
            answered = self._service.answers.ask(from_proto(QueryRequest, request))
            if answered.skipped and not answered.answers and not reads_skipped:
                raise _all_skipped(answered)
            return list(messages_of_query(answered))

        async with guarded(context, "Query"):
            for message in await self._threads.answer(asked):
                yield message

    async def StreamQuery(
        self, request_iterator: AsyncIterator[pb.StreamQueryRequest], context: Context
    ) -> AsyncIterator[pb.StreamQueryResponse]:
        """A standing question and pose after pose."""
        answers = answer_stream(self._service, self._threads, aiter(request_iterator))
        async with guarded(context, "StreamQuery"), aclosing(answers):
            async for message in answers:
                yield message

    async def RenderView(self, request: pb.RenderViewRequest, context: Context) -> AsyncIterator[pb.Chunk]:
        """One picture."""
        async with guarded(context, "RenderView"):
            picture = await self._threads.answer(
                lambda: self._service.answers.picture(from_proto(PictureRequest, request))
            )
            for chunk in chunks(picture):
                yield pb.Chunk(data=chunk)

    async def DownloadCameras(self, request: pb.DownloadCamerasRequest, context: Context) -> AsyncIterator[pb.Chunk]:
        """The scene's own cameras as a file."""
        async with guarded(context, "DownloadCameras"):
            content = await self._threads.call(
                lambda: self._service.camera_file(request.scene_id, from_proto(CameraFileRequest, request).format)
            )
            for chunk in chunks(content):
                yield pb.Chunk(data=chunk)

    async def DownloadScenePly(self, request: pb.DownloadScenePlyRequest, context: Context) -> AsyncIterator[pb.Chunk]:
        """The whole scene as a 3DGS PLY."""
        async with guarded(context, "DownloadScenePly"):
            if request.offset and not request.version:
                raise InvalidInputError(
                    "an offset without a version", field="version", hint="Name the version whose file broke off."
                )
            path, _ = await self._threads.call(
                lambda: self._service.answers.scene_ply(request.scene_id, request.version)
            )
            async with aclosing(self._file(path, request.offset)) as file:
                async for chunk in file:
                    yield chunk

    async def DownloadMaskPly(self, request: pb.DownloadMaskPlyRequest, context: Context) -> AsyncIterator[pb.Chunk]:
        """The Gaussians that answer a text as a 3DGS PLY."""
        async with guarded(context, "DownloadMaskPly"):
            ply = await self._threads.answer(
                lambda: self._service.answers.mask_ply(request.scene_id, request.text, request.version)
            )
            for chunk in chunks(ply):
                yield pb.Chunk(data=chunk)

    async def ExportScene(self, request: pb.ExportSceneRequest, context: Context) -> AsyncIterator[pb.Chunk]:
        """The scene as a file for other programs."""
        async with guarded(context, "ExportScene"):
            content = await self._threads.answer(lambda: self._service.exports.file(from_proto(ExportRequest, request)))
            for chunk in chunks(content):
                yield pb.Chunk(data=chunk)

    async def DownloadThingIds(self, request: pb.DownloadThingIdsRequest, context: Context) -> AsyncIterator[pb.Chunk]:
        """Which thing each Gaussian belongs to."""
        async with guarded(context, "DownloadThingIds"):
            ids = await self._threads.answer(lambda: self._service.answers.thing_ids(request.scene_id, request.version))
            for chunk in chunks(ids):
                yield pb.Chunk(data=chunk)

    async def ListPhotos(self, request: pb.ListPhotosRequest, context: Context) -> pb.ListPhotosResponse:
        """The photos that are stored with a scene, in pages."""
        async with guarded(context, "ListPhotos"):
            return await self._message(
                pb.ListPhotosResponse,
                lambda: self._service.photos.all(
                    request.scene_id, request.version, request.page_size, request.page_token
                ),
            )

    async def DownloadPhoto(self, request: pb.DownloadPhotoRequest, context: Context) -> AsyncIterator[pb.Chunk]:
        """A photo of one of the scene's cameras."""
        async with guarded(context, "DownloadPhoto"):
            path, _ = await self._threads.call(
                lambda: self._service.photos.path(request.scene_id, request.view, request.version)
            )
            async with aclosing(self._file(path, 0)) as file:
                async for chunk in file:
                    yield chunk

    async def ListBestViews(self, request: pb.ListBestViewsRequest, context: Context) -> pb.ListBestViewsResponse:
        """Which cameras show some things best."""
        async with guarded(context, "ListBestViews"):
            return await self._answer(
                pb.ListBestViewsResponse,
                lambda: self._service.photos.best_views(
                    request.scene_id, request.things, request.text, request.max_views, request.version
                ),
            )

    async def _file(self, path: Path, offset: int) -> AsyncGenerator[pb.Chunk]:
        size = path.stat().st_size
        if not 0 <= offset <= size:
            raise InvalidInputError(f"an offset of {offset} bytes", field="offset", limit=f"0 to {size} bytes")
        file = await self._threads.call(lambda: path.open("rb"))
        try:
            file.seek(offset)
            while data := await self._threads.call(lambda: file.read(CHUNK_BYTES)):
                yield pb.Chunk(data=data)
        finally:
            file.close()


def _all_skipped(answered: QueryOut) -> SceneFileError:
    first = answered.skipped[0]
    return SceneFileError(
        f"none of {answered.skipped_count} scenes could be asked; scene {first.scene_id}: {first.detail}",
        field="scene_id",
        hint="Name a scene, or send the metadata x-fastsplat-reads: skipped to hear of all of them.",
    )


async def _whole(messages: AsyncIterator[M], context: Context) -> AsyncIterator[M]:
    """The client's messages. Of a call that was cancelled gRPC reads an end like any other, sometimes long before the
    news of the cancellation; what has arrived then must not pass for the whole. A stream that the client has cut can
    no longer be written to either, one that has ended can: so the answer's head is sent first."""
    async for message in messages:
        yield message
    try:
        await context.send_initial_metadata(())
    except aio.InternalError:
        raise CancelledError("the sender went away") from None
    left = context.time_remaining()
    if context.done() or (left is not None and left <= 0):
        raise CancelledError("the sender went away")
