"""The RPCs that make a scene better: train it further, put it into a map, say where to stand for the next photos; where
a robot stands, what it needs to know of things, and where photos were taken."""

from __future__ import annotations

from fastsplat.api.access.caller import caller_id
from fastsplat.api.grpc.guard import Context, guarded
from fastsplat.api.grpc.messages import MessageServicer
from fastsplat_contract.localize_messages import LocalizeRequest
from fastsplat_contract.proto_codec import from_proto
from fastsplat_contract.scenes import AlignIn, Edit, SceneVersion
from fastsplat_contract.train_more_messages import TrainMoreIn
from fastsplat_contract.v1 import fastsplat_pb2 as pb


class ImprovingServicer(MessageServicer):
    """The part of `SceneServicer` that makes scenes better."""

    async def TrainMore(self, request: pb.TrainMoreRequest, context: Context) -> pb.Operation:
        """Train a scene further."""
        async with guarded(context, "TrainMore"):
            return await self._message(
                pb.Operation, lambda: self._service.training.order(request.scene_id, from_proto(TrainMoreIn, request))
            )

    async def AlignScene(self, request: pb.AlignSceneRequest, context: Context) -> pb.SceneVersion:
        """Put a scene into the frame of a map."""

        def align() -> SceneVersion:
            body = from_proto(AlignIn, request)
            edits = (Edit("align", alignment=body.alignment),)
            return self._service.versions.edit(request.scene_id, edits, body.request_id, "", caller_id())

        async with guarded(context, "AlignScene"):
            return await self._message(pb.SceneVersion, align)

    async def ListNextPhotos(self, request: pb.ListNextPhotosRequest, context: Context) -> pb.ListNextPhotosResponse:
        """Where to stand for the next photos."""
        async with guarded(context, "ListNextPhotos"):
            return await self._answer(
                pb.ListNextPhotosResponse, lambda: self._service.photos.next_photos(request.scene_id, request.version)
            )

    async def GetGoal(self, request: pb.GetGoalRequest, context: Context) -> pb.Goal:
        """Where a robot stands to see a thing."""
        async with guarded(context, "GetGoal"):
            return await self._answer(
                pb.Goal,
                lambda: self._service.exports.goal(
                    request.scene_id, request.thing_id, request.robot_radius, request.version
                ),
            )

    async def ListDetections(self, request: pb.ListDetectionsRequest, context: Context) -> pb.ListDetectionsResponse:
        """The things of a scene as a robot needs them, in pages."""
        async with guarded(context, "ListDetections"):
            return await self._answer(
                pb.ListDetectionsResponse,
                lambda: self._service.detections.all(
                    request.scene_id, request.version, request.page_size, request.page_token
                ),
            )

    async def Localize(self, request: pb.LocalizeRequest, context: Context) -> pb.Localization:
        """Where photos were taken."""
        async with guarded(context, "Localize"):
            return await self._answer(
                pb.Localization, lambda: self._service.localizing.localize(from_proto(LocalizeRequest, request))
            )
