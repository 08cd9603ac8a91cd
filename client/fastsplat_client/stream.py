"""gRPC transport of subscriptions: poses go in, masks and objects come out."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import grpc
from google.protobuf import message_factory
from google.protobuf.message import DecodeError
from grpc import aio

from fastsplat_client.errors import UnreachableError, error_of
from fastsplat_client.pending_queries import Connection, PendingQueries, StandingQuestion
from fastsplat_client.transport import Retry
from fastsplat_contract.codec.proto_codec import to_proto
from fastsplat_contract.errors import CancelledError, DeadlineExceededError, FastSplatError, InvalidInputError, Kind
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.messages.pieces import answers_of, query_of
from fastsplat_contract.messages.queries import Answer, QueryOut, QueryRequest
from fastsplat_contract.server.server_info import ServerInfo
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from fastsplat_contract.v1 import status_pb2

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


class _Call(Protocol):
    """The part of a streaming gRPC call that is used here."""

    def __iter__(self) -> Iterator[pb.StreamQueryResponse]: ...

    def cancel(self) -> object: ...


class KeepaliveReplies(Iterator[pb.StreamQueryResponse]):
    """Replies of a call with a timeout: where the reader waits too long for one, the call is cancelled.

    Time that the reader spends elsewhere does not count.

    Args:
        call: its replies are read.
        limit_s: says how long the silence may last, each time that it is looked at.
    """

    def __init__(self, call: _Call, limit_s: Callable[[], float]) -> None:
        self._call = call
        self._replies = iter(call)
        self._limit_s = limit_s
        self.timed_out = False
        """Whether the call was cancelled for its silence."""
        self._waiting_since: float | None = None
        self._over = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def __next__(self) -> pb.StreamQueryResponse:
        self._waiting_since = time.monotonic()
        try:
            return next(self._replies)
        finally:
            self._waiting_since = None

    def close(self) -> None:
        """Cancel the call, and watch it no longer."""
        self._over.set()
        self._call.cancel()

    def _watch(self) -> None:
        while not self._over.wait(self._limit_s() / 8):
            since = self._waiting_since
            if since is not None and time.monotonic() - since > self._limit_s():
                self.timed_out = True
                self._call.cancel()
                return


@dataclass(frozen=True)
class Reconnect(Retry):
    """Policy of reconnection: how a stream of answers goes on after its connection broke.

    Attributes:
        tries: connections in a row that may fail before the stream ends with the last one's error; 0: the stream ends
            with its connection.
        first_s, most_s: see `Retry`.
        silence_s: a connection over which nothing comes for so long, heartbeats included, is taken for broken; at least
            three heartbeats.
    """

    tries: int = 40
    silence_s: float = 30.0


@dataclass(frozen=True)
class PoseAnswer:
    """Answers for one pose.

    Attributes:
        sequence: which of the poses, counted from 1; it grows from answer to answer.
        question: which of the questions, counted from 1.
        answers: one a text.
        dropped: how many poses before this one, and after the last answer, were not looked at, or went with a
            connection.
        seconds: the server's, waiting aside.
        reconnected: how many new connections it took since the last answer.
    """

    sequence: int
    question: int
    answers: tuple[Answer, ...]
    dropped: int
    seconds: float
    reconnected: int = 0


@dataclass(frozen=True)
class Grpc:
    """Address and credentials of the gRPC interface.

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
    def opened(self) -> Iterator[tuple[SceneServiceStub, tuple[tuple[str, str], ...]]]:
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
                yield SceneServiceStub(channel), metadata
            except grpc.RpcError as error:
                raise error_from(error) from error

    def ask(self, request: QueryRequest, timeout_s: float) -> QueryOut:
        """One answer a text, and the scenes that were not asked, over gRPC; raises as `Client.ask_everywhere`."""
        with self.opened() as (stub, metadata):
            call = stub.Query(to_proto(request), timeout=timeout_s, metadata=metadata)
            return query_of(call, request.outputs)

    def stream_query(
        self, question: StandingQuestion, poses: Iterable[PosedCamera | StandingQuestion], reconnect: Reconnect
    ) -> Iterator[PoseAnswer]:
        """The answer to each pose that the server looks at; raises as `Client.stream_query`."""
        pending = PendingQueries(question, poses)
        failed = reconnected = 0
        established = False
        while True:
            connection = Connection()
            try:
                with closing(self._answers_over(connection, pending, reconnect.silence_s)) as answers:
                    for answer in answers:
                        yield replace(answer, reconnected=reconnected)
                        reconnected = 0
                broken: FastSplatError = UnreachableError("the server ended the stream")
            except FastSplatError as error:
                if not _may_pass(error):
                    raise
                broken = error
            established |= connection.accepted
            failed = 0 if connection.alive else failed
            if (connection.whole and pending.ended) or (established and pending.finished):
                if pending.error is not None:
                    raise pending.error
                return
            if not established or failed >= reconnect.tries:
                raise broken
            time.sleep(reconnect.pause(failed) if broken.retry_after_s is None else broken.retry_after_s)
            failed, reconnected = failed + 1, reconnected + 1

    def _answers_over(
        self, connection: Connection, pending: PendingQueries, silence_s: float
    ) -> Generator[PoseAnswer, None, None]:
        """The answers that come over one connection."""
        with self.opened() as (stub, metadata):
            call = stub.StreamQuery(pending.requests(connection), metadata=metadata)
            replies = KeepaliveReplies(call, lambda: max(silence_s, 3 * pending.longest_heartbeat_s))
            try:
                yield from _answers(replies, pending, connection)
            except grpc.RpcError as error:
                if replies.timed_out:
                    raise UnreachableError("nothing came any more, not even a heartbeat") from error
                raise
            finally:
                pending.close(connection)
                replies.close()


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


def _may_pass(error: FastSplatError) -> bool:
    """Whether the same may be taken by a later connection: the network or the server broke off, or asks to wait."""
    return error.kind in (Kind.UNAVAILABLE, Kind.CANCELLED) or error.retry_after_s is not None


def _answers(
    replies: Iterable[pb.StreamQueryResponse], pending: PendingQueries, connection: Connection
) -> Iterator[PoseAnswer]:
    """The answers that come over one connection, whose state is noted in it."""
    pieces: list[pb.QueryResponse] = []
    for reply in replies:
        part = reply.WhichOneof("part")
        if part == "accepted":
            connection.accepted = True
            continue
        connection.alive = True
        if part == "response":
            pieces.append(reply.response)
        elif part == "done":
            number = connection.asked[reply.question - 1]
            answers = tuple(answers_of(pieces, pending.question(number).outputs))
            dropped = pending.answered(reply.sequence)
            yield PoseAnswer(reply.sequence, number, answers, dropped, reply.done.seconds)
            pieces = []
    connection.whole = True
