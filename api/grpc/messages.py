"""Answers of any size in messages well below gRPC's 4 MiB."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from fastsplat.api.grpc.translate import answer_out, match_out, object_out
from fastsplat.service.calls import types
from fastsplat_contract.v1 import fastsplat_pb2 as pb

CHUNK_BYTES = 2**20
"""Size of the pieces of anything that could pass gRPC's 4 MiB."""

_OVERHEAD = 256


def messages_of(result: types.QueryAnswer) -> Iterator[pb.QueryResponse]:
    """One answer as one or several messages of about `CHUNK_BYTES` at most."""
    response = pb.QueryResponse(answer=answer_out(result))
    room = CHUNK_BYTES - response.ByteSize()
    # Up to here everything that has a message of its own; the first matches stand in the answer itself.
    into = response.answer.matches
    for match in map(match_out, result.answer.matches):
        if (size := match.ByteSize() + 8) > room:
            yield response
            response, room = pb.QueryResponse(), CHUNK_BYTES
            into = response.matches
        into.append(match)
        room -= size
    for piece in _mask_pieces(result.masks):
        if (size := piece.ByteSize() + 8) > room:
            yield response
            response, room = pb.QueryResponse(), CHUNK_BYTES
        response.masks.append(piece)
        room -= size
    for thing in map(object_out, result.objects):
        if (size := thing.ByteSize() + 8) > room:
            yield response
            response, room = pb.QueryResponse(), CHUNK_BYTES
        response.objects.append(thing)
        room -= size
    for chunk in chunks(result.mask3d):
        if len(chunk) > room:
            yield response
            response, room = pb.QueryResponse(), CHUNK_BYTES
        response.mask3d = chunk
        room = 0
    yield response


def chunks(data: bytes) -> Iterator[bytes]:
    """`data` in pieces of `CHUNK_BYTES`; none for no data."""
    for start in range(0, len(data), CHUNK_BYTES):
        yield data[start : start + CHUNK_BYTES]


def _mask_pieces(masks: Sequence[types.ViewMask]) -> Iterator[pb.ViewMask]:
    """Each mask, a long one in pieces of its counts or its PNG."""
    size = CHUNK_BYTES - 4 * _OVERHEAD
    for mask in masks:
        head = pb.ViewMask(view=mask.view, camera_index=mask.camera_index, area=mask.area, png=mask.png[:size])
        counts = "" if mask.rle is None else mask.rle.counts
        if mask.rle is not None:
            head.segmentation.CopyFrom(pb.RleMask(height=mask.rle.height, width=mask.rle.width, counts=counts[:size]))
        yield head
        for start in range(size, len(counts), size):
            yield pb.ViewMask(segmentation=pb.RleMask(counts=counts[start : start + size]), continues=True)
        for start in range(size, len(mask.png), size):
            yield pb.ViewMask(png=mask.png[start : start + size], continues=True)
