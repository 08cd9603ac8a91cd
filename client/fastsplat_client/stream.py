"""gRPC transport of subscriptions, with keepalive and reconnection."""

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
from fastsplat_client.pending_queries import Connection, PendingQueries, Subscription
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
    """Stub of `fastsplat.v1.SceneService` over a blocking or asyncio channel: `stub.GetScene(request)`."""

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
    def __iter__(self) -> Iterator[pb.StreamQueryResponse]: ...

    def cancel(self) -> object: ...


class KeepaliveReplies(Iterator[pb.StreamQueryResponse]):
    """Replies of a call, which is cancelled after `limit_s()` seconds without one."""

    def __init__(self, call: _Call, limit_s: Callable[[], float]) -> None:
        self._call = call
        self._replies = iter(call)
        self._limit_s = limit_s
        self.timed_out = False
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
    """Reconnection policy of a stream, with pauses as in `Retry`."""

    tries: int = 40  # connections in a row that may fail; 0: no reconnection
    silence_s: float = 30.0  # without even a heartbeat, until a connection counts as broken; at least 3 heartbeats


@dataclass(frozen=True)
class PoseAnswer:
    """Answers at one pose."""

    sequence: int  # number of the pose, from 1, increasing
    question: int  # number of the question, from 1
    answers: tuple[Answer, ...]  # one per text
    dropped: int  # poses since the last answer that were skipped or lost with a connection
    seconds: float  # the server's computing time, without waiting
    reconnected: int = 0  # new connections since the last answer


@dataclass(frozen=True)
class Grpc:
    """Address and credentials of the gRPC interface."""

    target: str  # "host:port"
    headers: Mapping[str, str]  # sent as metadata of every call
    secure: bool
    ca: Path | None  # PEM certificates to trust instead of the system's

    @contextmanager
    def opened(self) -> Iterator[tuple[SceneServiceStub, tuple[tuple[str, str], ...]]]:
        """Opens a stub and metadata; RPC errors in the block become `FastSplatError`."""
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
        with self.opened() as (stub, metadata):
            call = stub.Query(to_proto(request), timeout=timeout_s, metadata=metadata)
            return query_of(call, request.outputs)

    def stream_query(
        self, question: Subscription, poses: Iterable[PosedCamera | Subscription], reconnect: Reconnect
    ) -> Iterator[PoseAnswer]:
        """Yields answers and reconnects; raises as `Client.stream_query`."""
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
                if error.kind not in (Kind.UNAVAILABLE, Kind.CANCELLED) and error.retry_after_s is None:
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
    """Returns "host:port" of gRPC; raises `InvalidInputError` if the server does not report it."""
    if server.grpc is None:
        raise InvalidInputError(
            "the server does not say where its gRPC interface is",
            field="grpc_target",
            hint='Name it: Client(url, grpc_target="host:port").',
        )
    url_host = f"[{host}]" if ":" in host else host
    return f"{url_host}{server.grpc}" if server.grpc.startswith(":") else server.grpc


def error_from(error: grpc.RpcError) -> FastSplatError:
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
    """Extracts ErrorInfo and RetryInfo (seconds) from the google.rpc.Status, if present."""
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


def _answers(
    replies: Iterable[pb.StreamQueryResponse], pending: PendingQueries, connection: Connection
) -> Iterator[PoseAnswer]:
    """Yields the answers of one connection and updates its state."""
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
            number = connection.questions[reply.question - 1]
            answers = tuple(answers_of(pieces, pending.question(number).outputs))
            dropped = pending.answered(reply.sequence)
            yield PoseAnswer(reply.sequence, number, answers, dropped, reply.done.seconds)
            pieces = []
    connection.whole = True


_USUAL = Reconnect()


class StreamCalls:
    """Streaming calls of `Client`."""

    def _grpc(self) -> Grpc:
        raise NotImplementedError

    def stream_query(
        self, question: Subscription, poses: Iterable[PosedCamera | Subscription], *, reconnect: Reconnect = _USUAL
    ) -> Iterator[PoseAnswer]:
        """Answers a subscription at each pose, or at the newest if poses arrive faster.

        Once a question was accepted, a broken connection is replaced, and the newest question and unanswered pose are
        sent again. No pose is answered twice; lost ones count in `PoseAnswer.dropped`, new connections in
        `reconnected`. During pauses between tries the iterator blocks, and no poses are read.

        Args:
            question: asked at every pose.
            poses: cameras, read on a separate thread; a question among them replaces the one before.
            reconnect: reconnection policy.

        Raises:
            FastSplatError: a refusal by the server (revoked key, deleted scene), at once; or a connection error, if the
                first connection or all tries fail.
        """
        return self._grpc().stream_query(question, poses, reconnect)
