"""The RPCs of who runs a place: its keys, what its server can do, and the names that it knows."""

from __future__ import annotations

from google.protobuf import empty_pb2

from fastsplat.api.access.caller import caller_id, caller_role
from fastsplat.api.grpc.guard import Context, guarded
from fastsplat.api.grpc.messages import MessageServicer
from fastsplat_contract.keys import KeyIn, LifetimeIn, UploadKeyIn
from fastsplat_contract.proto_codec import from_proto
from fastsplat_contract.v1 import fastsplat_pb2 as pb


class AdminServicer(MessageServicer):
    """The part of `SceneServicer` that speaks of the place rather than of its scenes."""

    async def CreateKey(self, request: pb.CreateKeyRequest, context: Context) -> pb.NewKey:
        """Make a key of the project."""
        async with guarded(context, "CreateKey"):
            role = caller_role()
            return await self._message(pb.NewKey, lambda: self._service.keys.create(role, from_proto(KeyIn, request)))

    async def CreateUploadKey(self, request: pb.CreateUploadKeyRequest, context: Context) -> pb.NewKey:
        """Make a key for one upload."""
        async with guarded(context, "CreateUploadKey"):
            return await self._message(
                pb.NewKey, lambda: self._service.keys.create_for_upload(from_proto(UploadKeyIn, request))
            )

    async def GetServerStatus(self, request: empty_pb2.Empty, context: Context) -> pb.ServerStatus:
        """What the server can do."""
        async with guarded(context, "GetServerStatus"):
            role, key_id = caller_role(), caller_id()
            return await self._message(pb.ServerStatus, lambda: self._service.status(role, key_id))

    async def ListKeys(self, request: pb.ListKeysRequest, context: Context) -> pb.ListKeysResponse:
        """Keys of the project in pages."""
        async with guarded(context, "ListKeys"):
            role = caller_role()
            return await self._message(
                pb.ListKeysResponse,
                lambda: self._service.keys.list(role, request.page_size, request.page_token, request.scene_id),
            )

    async def RevokeKey(self, request: pb.RevokeKeyRequest, context: Context) -> pb.AccessKey:
        """Take a key back."""
        async with guarded(context, "RevokeKey"):
            role = caller_role()
            return await self._message(pb.AccessKey, lambda: self._service.keys.revoke(role, request.key_id))

    async def ExpireKey(self, request: pb.ExpireKeyRequest, context: Context) -> pb.AccessKey:
        """Let a key expire at another time."""
        async with guarded(context, "ExpireKey"):
            role = caller_role()
            lifetime_s = from_proto(LifetimeIn, request).lifetime_s
            return await self._message(
                pb.AccessKey, lambda: self._service.keys.expire(role, request.key_id, lifetime_s)
            )

    async def ListKnownNames(self, request: pb.ListKnownNamesRequest, context: Context) -> pb.ListKnownNamesResponse:
        """What people named in the project, in pages."""
        async with guarded(context, "ListKnownNames"):
            return await self._message(
                pb.ListKnownNamesResponse,
                lambda: self._service.known_names.list(request.page_size, request.page_token),
            )

    async def DeleteKnownName(self, request: pb.DeleteKnownNameRequest, context: Context) -> empty_pb2.Empty:
        """Suggest a name no more."""
        async with guarded(context, "DeleteKnownName"):
            await self._threads.call(lambda: self._service.known_names.forget(request.name_id))
            return empty_pb2.Empty()

    async def DeleteKnownNames(self, request: pb.DeleteKnownNamesRequest, context: Context) -> empty_pb2.Empty:
        """Suggest no name of the project any more."""
        async with guarded(context, "DeleteKnownNames"):
            await self._threads.call(self._service.known_names.forget_all)
            return empty_pb2.Empty()
