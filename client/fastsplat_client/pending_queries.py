"""Pending queries and poses of a subscription, whatever becomes of its connections."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from fastsplat_contract.codec.proto_codec import to_proto
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.v1 import fastsplat_pb2 as pb


@dataclass(frozen=True)
class StandingQuestion:
    """A query that is asked of every pose.

    Attributes:
        request: one scene, without cameras and views.
        heartbeat_s: how long the server may be silent; 0 for its own choice.
    """

    request: QueryRequest
    heartbeat_s: float = 0.0


@dataclass
class Connection:
    """One of the connections that a stream has had.

    Attributes:
        asked: the numbers of the questions that went over it, in their order.
        over: nothing more is sent over it.
        accepted: the server took a question.
        alive: the server went on after that. (One that ends with every pose takes the question each time.)
        whole: the server answered all that was sent, and ended the stream.
    """

    asked: list[int] = field(default_factory=list)
    over: bool = False
    accepted: bool = False
    alive: bool = False
    whole: bool = False


class PendingQueries:
    """Queue of a subscription: its newest query and pose, and the source of the next ones. Safe from any thread.

    The parts are read one at a time, each when the connection can take it, by the thread that sends them. A thread
    that still waits for a part when its connection breaks leaves that part here, for the next connection.

    Args:
        question: the first one.
        parts: poses, and questions that each replace the one before.
    """

    def __init__(self, question: StandingQuestion, parts: Iterable[PosedCamera | StandingQuestion]) -> None:
        self._parts = iter(parts)
        self._changed = threading.Condition()
        self._questions = [question]
        self._pose: PosedCamera | None = None
        self._sequence = 0
        self._answered = 0
        self._reading = False
        self._ended = False
        self.error: BaseException | None = None
        """What reading the parts raised; there are no more of them then."""

    def question(self, number: int) -> QueryRequest:
        """The question of that number, counted from 1."""
        return self._questions[number - 1].request

    @property
    def longest_heartbeat_s(self) -> float:
        """The largest that any question asked for."""
        with self._changed:
            return max(question.heartbeat_s for question in self._questions)

    @property
    def finished(self) -> bool:
        """Whether there are no more parts, and the newest pose was answered."""
        with self._changed:
            return self._ended and self._answered == self._sequence

    @property
    def ended(self) -> bool:
        """Whether there are no more parts."""
        with self._changed:
            return self._ended

    def answered(self, sequence: int) -> int:
        """Note that this pose was answered; returns how many before it, after the last answered one, were not."""
        with self._changed:
            dropped = sequence - self._answered - 1
            self._answered = sequence
            return dropped

    def close(self, connection: Connection) -> None:
        """Let no more be sent over it, and end the thread that waits to."""
        with self._changed:
            connection.over = True
            self._changed.notify_all()

    def requests(self, connection: Connection) -> Iterator[pb.StreamQueryRequest]:
        """What is sent over a connection: the newest question, the newest pose if it has no answer, then what comes."""
        sent = 0
        while True:
            with self._changed:
                while not connection.over and self._reading and not self._has_news(connection, sent):
                    self._changed.wait()
                if connection.over:
                    return
                if connection.asked[-1:] != [len(self._questions)]:
                    connection.asked.append(len(self._questions))
                    question = self._questions[-1]
                    request = pb.StreamQueryRequest(
                        question=pb.StandingQuestion(query=to_proto(question.request), heartbeat_s=question.heartbeat_s)
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
        asked = connection.asked[-1:] == [len(self._questions)]
        return self._ended or not asked or self._sequence > max(sent, self._answered)

    def _read(self) -> None:
        """Take in the next part; nobody else does meanwhile."""
        part, error, ended = None, None, False
        try:
            part = next(self._parts)
        except StopIteration:
            ended = True
        except BaseException as raised:  # it is raised where the answers are read
            error, ended = raised, True
        with self._changed:
            self._reading = False
            self._ended = ended
            self.error = error
            if isinstance(part, StandingQuestion):
                self._questions.append(part)
            elif part is not None:
                self._sequence += 1
                self._pose = part
            self._changed.notify_all()
