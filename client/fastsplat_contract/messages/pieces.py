"""Answers of any size as messages well below gRPC's 4 MiB, and together again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Set
from dataclasses import replace

from fastsplat_contract.codec.proto_codec import from_proto, to_proto
from fastsplat_contract.masks import ViewMask
from fastsplat_contract.messages.queries import Answer, QueryOut, SkippedScene
from fastsplat_contract.v1 import fastsplat_pb2 as pb

CHUNK_BYTES = 2**20
"""Size of the pieces of anything that could pass gRPC's 4 MiB."""

_MASK_BYTES = CHUNK_BYTES - 1024


def messages_of(answer: Answer) -> Iterator[pb.QueryResponse]:
    """One answer as one or several messages of about `CHUNK_BYTES` at most."""
    response = pb.QueryResponse(answer=to_proto(replace(answer, matches=())))
    room = CHUNK_BYTES - response.ByteSize()
    # Up to here everything that has a message of its own; the first matches stand in the answer itself.
    into = response.answer.matches
    for match in map(to_proto, answer.matches):
        if (size := match.ByteSize() + 8) > room:
            yield response
            response, room = pb.QueryResponse(), CHUNK_BYTES
            into = response.matches
        into.append(match)
        room -= size
    for piece in _mask_pieces(answer.masks):
        if (size := piece.ByteSize() + 8) > room:
            yield response
            response, room = pb.QueryResponse(), CHUNK_BYTES
        response.masks.append(piece)
        room -= size
    for obj in map(to_proto, answer.objects or ()):
        if (size := obj.ByteSize() + 8) > room:
            yield response
            response, room = pb.QueryResponse(), CHUNK_BYTES
        response.objects.append(obj)
        room -= size
    if answer.mask3d is not None:
        response.mask3d = b""
    for chunk in chunks(answer.mask3d or b""):
        if len(chunk) > room:
            yield response
            response, room = pb.QueryResponse(), CHUNK_BYTES
        response.mask3d = chunk
        room = 0
    yield response


def answers_of(responses: Iterable[pb.QueryResponse], outputs: Set[str]) -> Iterator[Answer]:
    """The answers in the messages of a Query that asked for `outputs`."""
    for whole in _joined(responses):
        answer = from_proto(Answer, whole.answer, carrier=whole)
        # Over gRPC no objects and objects that were not asked for look alike.
        yield replace(answer, objects=()) if "objects" in outputs and answer.objects is None else answer


def messages_of_query(answered: QueryOut) -> Iterator[pb.QueryResponse]:
    """All answers as `messages_of`, then, if there are any, the scenes that were not asked."""
    for answer in answered.answers:
        yield from messages_of(answer)
    if answered.skipped_count:
        yield pb.QueryResponse(skipped=map(to_proto, answered.skipped), skipped_count=answered.skipped_count)


def query_of(responses: Iterable[pb.QueryResponse], outputs: Set[str]) -> QueryOut:
    """All that the messages of a Query say that asked for `outputs`."""
    skipped: list[SkippedScene] = []
    count = 0

    def about_answers() -> Iterator[pb.QueryResponse]:
        nonlocal count
        for response in responses:
            if response.skipped_count:
                skipped.extend(from_proto(SkippedScene, scene) for scene in response.skipped)
                count = response.skipped_count
            else:
                yield response

    answers = tuple(answers_of(about_answers(), outputs))
    return QueryOut(answers, tuple(skipped), count)


def chunks(data: bytes) -> Iterator[bytes]:
    """`data` in pieces of `CHUNK_BYTES`; none for no data."""
    for start in range(0, len(data), CHUNK_BYTES):
        yield data[start : start + CHUNK_BYTES]


def _joined(responses: Iterable[pb.QueryResponse]) -> Iterator[pb.QueryResponse]:
    """The messages of a Query put together again, one for each answer."""
    whole: pb.QueryResponse | None = None
    for response in responses:
        if response.HasField("answer"):
            if whole is not None:
                yield whole
            whole = pb.QueryResponse(answer=response.answer)
        assert whole is not None, "the first message of a Query carries an answer"
        whole.answer.matches.extend(response.matches)
        for mask in response.masks:
            if not mask.continues:
                whole.masks.append(mask)
            elif mask.png:
                whole.masks[-1].png += mask.png
            else:
                whole.masks[-1].segmentation.counts += mask.segmentation.counts
        whole.objects.extend(response.objects)
        if response.HasField("mask3d"):
            whole.mask3d += response.mask3d
    if whole is not None:
        yield whole


def _mask_pieces(masks: Iterable[ViewMask]) -> Iterator[pb.ViewMask]:
    """Each mask, a long one in pieces of its counts or its PNG."""
    size = _MASK_BYTES
    for mask in map(to_proto, masks):
        counts, png = mask.segmentation.counts, mask.png
        if mask.HasField("png"):
            mask.png = png[:size]
        if mask.HasField("segmentation"):
            mask.segmentation.counts = counts[:size]
        yield mask
        for start in range(size, len(counts), size):
            yield pb.ViewMask(segmentation=pb.Segmentation(counts=counts[start : start + size]), continues=True)
        for start in range(size, len(png), size):
            yield pb.ViewMask(png=png[start : start + size], continues=True)
