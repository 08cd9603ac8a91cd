"""Standing questions: poses go in as a robot moves, answers come out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from fastsplat_client.pending_queries import StandingQuestion
from fastsplat_client.stream import Grpc, PoseAnswer, Reconnect
from fastsplat_contract.geometry.camera import PosedCamera

_USUAL = Reconnect()


class StreamCalls:
    """The part of `Client` that goes over gRPC as a stream."""

    def _grpc(self) -> Grpc:
        raise NotImplementedError

    def stream_query(
        self,
        question: StandingQuestion,
        poses: Iterable[PosedCamera | StandingQuestion],
        *,
        reconnect: Reconnect = _USUAL,
    ) -> Iterator[PoseAnswer]:
        """A standing question: an answer for each pose, or for the newest of those that came faster than the answers.

        When the connection breaks once a question was accepted, a new one is made: the newest question is asked again
        by itself, and by it the newest pose, if that has no answer yet. No pose is answered twice; those that went with
        the connection are counted in `PoseAnswer.dropped`, new connections in `reconnected`. The pauses between tries
        are spent where the next answer is waited for; poses are not read meanwhile.

        Args:
            question: what is asked of every pose.
            poses: cameras as the robot moves, read on a thread of its own; a question among them replaces the one
                before.
            reconnect: see `Reconnect`.

        Raises:
            FastSplatError: what the server refuses (as a key that was revoked, a scene that is gone), at once; what
                broke the connection, where the first one failed or all tries have.
        """
        return self._grpc().stream_query(question, poses, reconnect)
