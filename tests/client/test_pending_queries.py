"""What a new connection asks again, and what it never does."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import islice

import numpy as np

from fastsplat_client import Camera, PosedCamera, QueryRequest, Subscription
from fastsplat_client.pending_queries import Connection, PendingQueries
from fastsplat_contract.v1 import fastsplat_pb2 as pb

_POSE = PosedCamera(Camera(4, 3, 4.0, 4.0, 2.0, 1.5), np.eye(4), "")


def _question(text: str) -> Subscription:
    return Subscription(QueryRequest("s", (text,)))


def _sent(request: pb.StreamQueryRequest) -> str | int:
    return request.question.query.texts[0] if request.HasField("question") else request.pose.sequence


def test_the_newest_question_and_the_newest_pose_without_an_answer_are_sent_again() -> None:
    pending = PendingQueries(_question("mug"), [_POSE, _question("ball"), _POSE, _POSE, _POSE])
    first = Connection()
    assert [_sent(request) for request in islice(pending.requests(first), 5)] == ["mug", 1, "ball", 2, 3]
    assert pending.answered(1) == 0 and first.questions == [1, 2]
    pending.close(first)
    second = Connection()
    assert [_sent(request) for request in islice(pending.requests(second), 2)] == ["ball", 3]
    assert pending.answered(3) == 1  # 2 went with the connection
    pending.close(second)
    third = Connection()
    assert [_sent(request) for request in pending.requests(third)] == ["ball", 4]
    assert third.questions == [2] and pending.ended and not pending.finished
    pending.answered(4)
    assert pending.finished
    assert [_sent(request) for request in pending.requests(Connection())] == ["ball"]


def test_a_pose_that_comes_after_its_connection_broke_goes_over_the_next_one() -> None:
    come = threading.Event()
    waits = threading.Event()

    def poses() -> Iterator[PosedCamera]:
        waits.set()
        assert come.wait(60)
        yield _POSE

    pending = PendingQueries(_question("mug"), poses())
    first, second = Connection(), Connection()
    lost = threading.Thread(target=lambda: list(pending.requests(first)))
    lost.start()
    assert waits.wait(60)
    pending.close(first)
    requests = pending.requests(second)
    assert _sent(next(requests)) == "mug"
    threading.Timer(0.05, come.set).start()
    assert _sent(next(requests)) == 1
    lost.join(60)
    assert not lost.is_alive()
