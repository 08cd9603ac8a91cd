"""What all RPCs share: the service, its threads, and results that are made messages on them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.proto_codec import to_proto
from fastsplat_contract.v1 import fastsplat_pb2_grpc as pb_grpc

M = TypeVar("M")


def as_message(kind: type[M], value: object) -> M:
    """A value of the contract as its message, which is of this type."""
    message = to_proto(value)
    assert isinstance(message, kind)
    return message


class MessageServicer(pb_grpc.SceneServiceServicer):
    """The part of `SceneServicer` that its other parts are made with."""

    _service: SceneService
    _threads: Threads

    async def _message(self, kind: type[M], function: Callable[[], object]) -> M:
        """A service call's result as its message, both made on a thread."""
        return await self._threads.call(lambda: as_message(kind, function()))

    async def _answer(self, kind: type[M], function: Callable[[], object]) -> M:
        """The same for a question or a picture, see `Threads.answer`."""
        return await self._threads.answer(lambda: as_message(kind, function()))
