"""What goes over gRPC: standing questions, where poses go in and masks and objects come out."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import grpc
from google.protobuf.message import DecodeError

from fastsplat_client.errors import UnreachableError, error_of
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.errors import CancelledError, DeadlineExceededError, FastSplatError, InvalidInputError, Kind
from fastsplat_contract.pieces import READS_SKIPPED, answers_of, query_of
from fastsplat_contract.proto_codec import to_proto
from fastsplat_contract.queries import Answer, QueryOut, QueryRequest
from fastsplat_contract.server_info import ServerInfo
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from fastsplat_contract.v1 import fastsplat_pb2_grpc as rpc
from fastsplat_contract.v1 import status_pb2


@dataclass(frozen=True)
class StandingQuestion:
    """What is asked of every pose.

    Attributes:
        request: one scene, without cameras and views.
        heartbeat_s: how long the server may be silent; 0 for its own choice.
    """

    request: QueryRequest
    heartbeat_s: float = 0.0


@dataclass(frozen=True)
class PoseAnswer:
    """What one pose brought.

    Attributes:
        sequence: which of the poses, counted from 1.
        question: which of the questions, counted from 1.
        answers: one a text.
        dropped: how many poses before this one, and after the last answer, were not looked at.
        seconds: the server's, waiting aside.
    """

    sequence: int
    question: int
    answers: tuple[Answer, ...]
    dropped: int
    seconds: float


@dataclass(frozen=True)
class Grpc:
    """Where the gRPC interface is, and how to get in.

    Attributes:
        target: "host:port".
        headers: of every call, as metadata: who asks, about which project.
        secure: whether it speaks TLS.
        ca: PEM certificates to trust in place of the system's.
    """

    target: str
    headers: Mapping[str, str]
    secure: bool
    ca: Path | None

    @contextmanager
    def opened(self) -> Iterator[tuple[rpc.SceneServiceStub, tuple[tuple[str, str], ...]]]:
        """A stub and the metadata of its calls; what they raise is the service's own.

        Raises:
            FastSplatError: what the server raised, `UnreachableError` or `DeadlineExceededError`.
        """
        if self.secure:
            credentials = grpc.ssl_channel_credentials(None if self.ca is None else self.ca.read_bytes())
            channel = grpc.secure_channel(self.target, credentials)
        else:
            channel = grpc.insecure_channel(self.target)
        with channel:
            try:
                metadata = tuple((name.lower(), value) for name, value in self.headers.items())
                yield rpc.SceneServiceStub(channel), metadata
            except grpc.RpcError as error:
                raise error_from(error) from error

    def ask(self, request: QueryRequest, timeout_s: float) -> QueryOut:
        """One answer a text, and the scenes that were not asked, over gRPC; raises as `Client.ask_everywhere`."""
        with self.opened() as (stub, metadata):
            call = stub.Query(to_proto(request), timeout=timeout_s, metadata=(*metadata, READS_SKIPPED))
            return query_of(call, request.outputs)

    def stream_query(
        self, question: StandingQuestion, poses: Iterable[PosedCamera | StandingQuestion]
    ) -> Iterator[PoseAnswer]:
        """The answer to each pose that the server looks at; raises as `Client.stream_query`."""
        with self.opened() as (stub, metadata):
            questions: list[QueryRequest] = []
            call = stub.StreamQuery(_requests(question, poses, questions), metadata=metadata)
            try:
                yield from _answers(call, questions)
            finally:
                call.cancel()


def grpc_address(server: ServerInfo, host: str) -> str:
    """ "host:port" of a server that was asked at `host`.

    Raises:
        InvalidInputError: it does not say where its gRPC interface is.
    """
    if server.grpc is None:
        raise InvalidInputError(
            "the server does not say where its gRPC interface is",
            field="grpc_target",
            hint='Name it: Client(url, grpc_target="host:port").',
        )
    own = f"[{host}]" if ":" in host else host
    return f"{own}{server.grpc}" if server.grpc.startswith(":") else server.grpc


def error_from(error: grpc.RpcError) -> FastSplatError:
    """What a failed RPC says, as the exception that the server raised."""
    assert isinstance(error, grpc.Call)
    info, retry_after_s = _details(error)
    if info is not None:
        return error_of(info.reason, _kind(error), error.details() or "", info.metadata, retry_after_s)
    if error.code() is grpc.StatusCode.DEADLINE_EXCEEDED:
        return DeadlineExceededError("no answer in time", hint="Give it more time.")
    if error.code() is grpc.StatusCode.CANCELLED:
        return CancelledError("the call was cancelled")
    return UnreachableError(f"{error.code().name}: {error.details()}", hint="Is the server running?")


def _details(error: grpc.Call) -> tuple[status_pb2.ErrorInfo | None, float | None]:
    """The ErrorInfo of a google.rpc.Status, and the seconds of its RetryInfo, where there are such."""
    metadata = {str(key): value for key, value in error.trailing_metadata() or ()}
    content = metadata.get("grpc-status-details-bin", b"")
    info: status_pb2.ErrorInfo | None = None
    retry_after_s: float | None = None
    try:
        for detail in status_pb2.Status.FromString(content if isinstance(content, bytes) else b"").details:
            if detail.type_url.endswith("/google.rpc.ErrorInfo"):
                info = status_pb2.ErrorInfo.FromString(detail.value)
            elif detail.type_url.endswith("/google.rpc.RetryInfo"):
                delay = status_pb2.RetryInfo.FromString(detail.value).retry_delay
                retry_after_s = delay.seconds + delay.nanos * 1e-9
    except DecodeError:
        return None, None  # not from this service
    return info, retry_after_s


def _kind(error: grpc.Call) -> Kind:
    name = error.code().name
    return Kind[name] if name in Kind.__members__ else Kind.INTERNAL


def _requests(
    question: StandingQuestion, poses: Iterable[PosedCamera | StandingQuestion], questions: list[QueryRequest]
) -> Iterator[pb.StreamQueryRequest]:
    """What is sent; `questions` grows by each question."""
    sequence = 0
    for part in itertools.chain((question,), poses):
        if isinstance(part, StandingQuestion):
            questions.append(part.request)
            standing = pb.StandingQuestion(query=to_proto(part.request), heartbeat_s=part.heartbeat_s)
            yield pb.StreamQueryRequest(question=standing)
        else:
            sequence += 1
            yield pb.StreamQueryRequest(pose=pb.StreamPose(sequence=sequence, camera=to_proto(part)))


def _answers(call: Iterable[pb.StreamQueryResponse], questions: Sequence[QueryRequest]) -> Iterator[PoseAnswer]:
    pieces: list[pb.QueryResponse] = []
    dropped = 0
    for reply in call:
        part = reply.WhichOneof("part")
        if part == "response":
            pieces.append(reply.response)
        elif part == "dropped":
            dropped += reply.dropped.count
        elif part == "done":
            answers = tuple(answers_of(pieces, questions[reply.question - 1].outputs))
            yield PoseAnswer(reply.sequence, reply.question, answers, dropped, reply.done.seconds)
            pieces, dropped = [], 0
