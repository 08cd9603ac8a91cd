"""Standing questions, answered at a stream of poses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from fastsplat_client.pending_queries import StandingQuestion
from fastsplat_client.stream import Grpc, PoseAnswer, Reconnect
from fastsplat_contract.geometry.camera import PosedCamera

_USUAL = Reconnect()


class StreamCalls:
    """Streaming calls of `Client`."""

    def _grpc(self) -> Grpc:
        raise NotImplementedError

    def stream_query(
        self,
        question: StandingQuestion,
        poses: Iterable[PosedCamera | StandingQuestion],
        *,
        reconnect: Reconnect = _USUAL,
    ) -> Iterator[PoseAnswer]:
        """Answers a standing question at each pose, or at the newest if poses arrive faster.

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
