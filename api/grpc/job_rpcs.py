"""The RPCs of what jobs show of their scenes while they run, and of ending one early."""

from __future__ import annotations

from fastsplat.api.grpc.guard import Context, guarded
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.proto_codec import to_proto
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from fastsplat_contract.v1 import fastsplat_pb2_grpc as pb_grpc


class JobServicer(pb_grpc.SceneServiceServicer):
    """The part of `SceneServicer` that speaks of jobs while they run."""

    _service: SceneService
    _threads: Threads

    async def FinishOperation(  # noqa: N802
        self, request: pb.FinishOperationRequest, context: Context
    ) -> pb.Operation:
        """Ask a job to end its training early."""

        def finished() -> pb.Operation:
            message: pb.Operation = to_proto(self._service.jobs.finish(request.operation_id))
            return message

        async with guarded(context, "FinishOperation"):
            return await self._threads.call(finished)

    async def GetPreview(self, request: pb.GetPreviewRequest, context: Context) -> pb.Preview:  # noqa: N802
        """The newest picture of a scene that is being trained."""

        def preview() -> pb.Preview:
            message: pb.Preview = to_proto(self._service.jobs.preview(request.operation_id))
            return message

        async with guarded(context, "GetPreview"):
            return await self._threads.call(preview)

    async def GetPlacedCameras(  # noqa: N802
        self, request: pb.GetPlacedCamerasRequest, context: Context
    ) -> pb.PlacedCameras:
        """The cameras that a job has placed so far, and some of its points."""

        def placed() -> pb.PlacedCameras:
            message: pb.PlacedCameras = to_proto(self._service.jobs.placed_cameras(request.operation_id))
            return message

        async with guarded(context, "GetPlacedCameras"):
            return await self._threads.call(placed)
