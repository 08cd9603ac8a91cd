"""The RPCs of what jobs show of their scenes while they run, and of ending one early."""

from __future__ import annotations

from fastsplat.api.grpc.guard import Context, guarded
from fastsplat.api.grpc.messages import MessageServicer
from fastsplat_contract.v1 import fastsplat_pb2 as pb


class JobServicer(MessageServicer):
    """The part of `SceneServicer` that speaks of jobs while they run."""

    async def FinishOperation(self, request: pb.FinishOperationRequest, context: Context) -> pb.Operation:
        """Ask a job to end its training early."""
        async with guarded(context, "FinishOperation"):
            return await self._message(pb.Operation, lambda: self._service.jobs.finish(request.operation_id))

    async def GetPreview(self, request: pb.GetPreviewRequest, context: Context) -> pb.Preview:
        """The newest picture of a scene that is being trained."""
        async with guarded(context, "GetPreview"):
            return await self._message(pb.Preview, lambda: self._service.jobs.preview(request.operation_id))

    async def GetPlacedCameras(self, request: pb.GetPlacedCamerasRequest, context: Context) -> pb.PlacedCameras:
        """The cameras that a job has placed so far, and some of its points."""
        async with guarded(context, "GetPlacedCameras"):
            return await self._message(
                pb.PlacedCameras, lambda: self._service.jobs.placed_cameras(request.operation_id)
            )
