"""Pending questions and poses of a stream, kept across reconnects."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from fastsplat_contract.codec.proto_codec import to_proto
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.v1 import fastsplat_pb2 as pb


@dataclass(frozen=True)
class Subscription:
    """A query that is asked at every pose."""

    request: QueryRequest  # for one scene, without cameras and views
    heartbeat_s: float = 0.0  # longest silence of the server; 0: its default


@dataclass
class Connection:
    """State of one connection of a stream."""

    questions: list[int] = field(default_factory=list)  # numbers of the questions sent, in order
    over: bool = False
    accepted: bool = False  # the server accepted a question
    alive: bool = False  # and sent more after it; a server that fails at every pose still accepts questions
    whole: bool = False  # the server answered everything and ended the stream


class PendingQueries:
    """Thread-safe queue of a stream: newest question, newest pose, source of further parts.

    The sending thread reads parts one at a time, when the connection can take them. A part that arrives after its
    connection broke is kept for the next one.
    """

    def __init__(self, question: Subscription, parts: Iterable[PosedCamera | Subscription]) -> None:
        self._parts = iter(parts)
        self._changed = threading.Condition()
        self._questions = [question]
        self._pose: PosedCamera | None = None
        self._sequence = 0
        self._answered = 0
        self._reading = False
        self._ended = False
        self.error: BaseException | None = None
        """Exception raised by `parts`, which ends them."""

    def question(self, number: int) -> QueryRequest:
        """Returns a question by number, from 1."""
        return self._questions[number - 1].request

    @property
    def longest_heartbeat_s(self) -> float:
        with self._changed:
            return max(question.heartbeat_s for question in self._questions)

    @property
    def finished(self) -> bool:
        """True if there are no more parts and the newest pose was answered."""
        with self._changed:
            return self._ended and self._answered == self._sequence

    @property
    def ended(self) -> bool:
        with self._changed:
            return self._ended

    def answered(self, sequence: int) -> int:
        """Records an answered pose; returns the number of unanswered ones since the last answer."""
        with self._changed:
            dropped = sequence - self._answered - 1
            self._answered = sequence
            return dropped

    def close(self, connection: Connection) -> None:
        """Stops sending over a connection and releases its waiting thread."""
        with self._changed:
            connection.over = True
            self._changed.notify_all()

    def requests(self, connection: Connection) -> Iterator[pb.StreamQueryRequest]:
        """Yields a connection's requests: newest question, newest unanswered pose, then further parts."""
        sent = 0
        while True:
            with self._changed:
                while not connection.over and self._reading and not self._has_news(connection, sent):
                    self._changed.wait()
                if connection.over:
                    return
                if connection.questions[-1:] != [len(self._questions)]:
                    connection.questions.append(len(self._questions))
                    question = self._questions[-1]
                    request = pb.StreamQueryRequest(
                        question=pb.Subscription(query=to_proto(question.request), heartbeat_s=question.heartbeat_s)
                    )
                elif self._pose is not None and self._sequence > max(sent, self._answered):
                    sent = self._sequence
                    request = pb.StreamQueryRequest(pose=pb.StreamPose(sequence=sent, camera=to_proto(self._pose)))
                elif self._ended:
                    return
                else:
                    self._reading, request = True, None
            if request is None:
                self._read()
            else:
                yield request

    def _has_news(self, connection: Connection, sent: int) -> bool:
        current = connection.questions[-1:] == [len(self._questions)]
        return self._ended or not current or self._sequence > max(sent, self._answered)

    def _read(self) -> None:
        """Reads the next part; only one thread does so at a time."""
        part, error, ended = None, None, False
        try:
            part = next(self._parts)
        except StopIteration:
            ended = True
        except BaseException as raised:  # raised again where answers are read
            error, ended = raised, True
        with self._changed:
            self._reading = False
            self._ended = ended
            self.error = error
            if isinstance(part, Subscription):
                self._questions.append(part)
            elif part is not None:
                self._sequence += 1
                self._pose = part
            self._changed.notify_all()
