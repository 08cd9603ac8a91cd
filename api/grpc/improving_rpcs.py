"""The RPCs that make a scene better: train it further, put it into a map, say where to stand for the next photos."""

from __future__ import annotations

from fastsplat.api.access.caller import caller_id
from fastsplat.api.grpc.guard import Context, guarded
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.proto_codec import from_proto, to_proto
from fastsplat_contract.scenes import AlignIn, Edit
from fastsplat_contract.train_more_messages import TrainMoreIn
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from fastsplat_contract.v1 import fastsplat_pb2_grpc as pb_grpc


class ImprovingServicer(pb_grpc.SceneServiceServicer):
    """The part of `SceneServicer` that makes scenes better."""

    _service: SceneService
    _threads: Threads

    async def TrainMore(self, request: pb.TrainMoreRequest, context: Context) -> pb.Operation:  # noqa: N802
        """Train a scene further."""

        def ordered() -> pb.Operation:
            operation = self._service.training.order(request.scene_id, from_proto(TrainMoreIn, request))
            message: pb.Operation = to_proto(operation)
            return message

        async with guarded(context, "TrainMore"):
            return await self._threads.call(ordered)

    async def AlignScene(self, request: pb.AlignSceneRequest, context: Context) -> pb.SceneVersion:  # noqa: N802
        """Put a scene into the frame of a map."""

        def aligned() -> pb.SceneVersion:
            body = from_proto(AlignIn, request)
            edits = (Edit("align", alignment=body.alignment),)
            made = self._service.versions.edit(request.scene_id, edits, body.request_id, "", caller_id())
            message: pb.SceneVersion = to_proto(made)
            return message

        async with guarded(context, "AlignScene"):
            return await self._threads.call(aligned)

    async def ListNextPhotos(  # noqa: N802
        self, request: pb.ListNextPhotosRequest, context: Context
    ) -> pb.ListNextPhotosResponse:
        """Where to stand for the next photos."""

        def listed() -> pb.ListNextPhotosResponse:
            message: pb.ListNextPhotosResponse = to_proto(
                self._service.photos.next_photos(request.scene_id, request.version)
            )
            return message

        async with guarded(context, "ListNextPhotos"):
            return await self._threads.answer(listed)
