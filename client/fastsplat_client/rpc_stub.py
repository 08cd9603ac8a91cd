"""The caller's side of gRPC: a call for each RPC of the .proto, made of its description."""

from __future__ import annotations

from typing import Any

import grpc
from google.protobuf import message_factory
from grpc import aio

from fastsplat_contract.v1 import fastsplat_pb2 as pb

_SERVICE = pb.DESCRIPTOR.services_by_name["SceneService"]


class SceneServiceStub:
    """The RPCs of `fastsplat.v1.SceneService` over a channel, each by its name, as `stub.GetScene(request)`.

    Args:
        channel: to the server; of `grpc.aio` where calls are awaited.
    """

    def __init__(self, channel: grpc.Channel | aio.Channel) -> None:
        for rpc, method in _SERVICE.methods_by_name.items():
            kinds = ("stream" if many else "unary" for many in (method.client_streaming, method.server_streaming))
            request, response = map(message_factory.GetMessageClass, (method.input_type, method.output_type))
            call = getattr(channel, "_".join(kinds))(
                f"/{_SERVICE.full_name}/{rpc}",
                request_serializer=request.SerializeToString,
                response_deserializer=response.FromString,
            )
            setattr(self, rpc, call)

    def __getattr__(self, rpc: str) -> Any:
        raise AttributeError(f"{_SERVICE.full_name} has no RPC {rpc!r}")
