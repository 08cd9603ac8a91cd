"""Bytes that are no message, and metadata that is no key, to every RPC: each gets an answer with a reason."""

from __future__ import annotations

import random
from collections.abc import Iterator

import grpc
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.served import Faces

_SERVICE = pb.DESCRIPTOR.services_by_name["SceneService"]
_METHODS = [method.name for method in _SERVICE.methods]
_TIMEOUT_S = 60.0
_TYPED = {"INVALID_ARGUMENT", "NOT_FOUND", "FAILED_PRECONDITION", "RESOURCE_EXHAUSTED", "OUT_OF_RANGE", "ABORTED"}


@pytest.mark.parametrize("method", _METHODS)
def test_bytes_that_are_no_message_are_refused_with_a_reason(faces: Faces, scene_id: str, method: str) -> None:
    draw = random.Random(method)
    for content in _broken(draw, scene_id):
        error = _error_of(faces.channel, method, content)
        if error is None:
            continue  # by chance a message, and one that may be asked
        assert error.code().name in _TYPED, (method, content, error.code(), error.details())
        assert _reason(error), (method, content)


@pytest.mark.parametrize("method", _METHODS)
def test_a_message_that_cannot_be_read_is_said_to_be_one(faces: Faces, method: str) -> None:
    error = _error_of(faces.channel, method, b"\x0a\xff")  # a string longer than the message
    assert error is not None
    assert (error.code().name, _reason(error)) == ("INVALID_ARGUMENT", "INVALID_INPUT")


def test_strange_metadata_changes_nothing(faces: Faces, scene_id: str) -> None:
    draw = random.Random(0)
    request = pb.GetSceneRequest(scene_id=scene_id)
    for _ in range(100):
        name = "".join(draw.choice("abcxyz0189-_.") for _ in range(draw.randint(1, 60)))
        text = "".join(chr(draw.randint(32, 126)) for _ in range(draw.randint(0, 3_000)))
        metadata = [(draw.choice([name, "authorization", "x-api-key", "x-request-id"]), text)]
        metadata.append((f"{name}-bin", draw.randbytes(draw.randint(0, 500))))
        assert faces.rpc.GetScene(request, metadata=metadata, timeout=_TIMEOUT_S).id == scene_id


def _broken(draw: random.Random, scene_id: str) -> Iterator[bytes]:
    yield from (b"\xff", b"\x0a\xff", b"\x0a\x02\xff\xfe", b"\x08" + b"\xff" * 11)
    real = pb.GetSceneRequest(scene_id=scene_id).SerializeToString()
    for _ in range(12):
        yield draw.randbytes(draw.randint(1, 200))
        flipped = bytearray(real + draw.randbytes(20))
        flipped[draw.randrange(len(flipped))] ^= 1 << draw.randrange(8)
        yield bytes(flipped)


def _error_of(channel: grpc.Channel, method: str, content: bytes) -> grpc.RpcError | None:
    descriptor = _SERVICE.methods_by_name[method]
    path = f"/{_SERVICE.full_name}/{method}"
    kind = ("stream" if descriptor.client_streaming else "unary", "stream" if descriptor.server_streaming else "unary")
    call = getattr(channel, "_".join(kind))(path)
    request = iter([content]) if descriptor.client_streaming else content
    try:
        answer = call(request, timeout=_TIMEOUT_S)
        if descriptor.server_streaming:
            for _ in answer:
                pass
    except grpc.RpcError as error:
        return error
    return None


def _reason(error: grpc.RpcError) -> str:
    status = rpc_status.from_call(error)
    for detail in status.details if status else ():
        info = error_details_pb2.ErrorInfo()
        if detail.Unpack(info):
            return info.reason
    return ""
