"""Subscriptions over a real server: every pose is answered or announced as dropped."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import grpc
import numpy as np
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.language.ranking import Ranker
from fastsplat.service.query.language.words.query_text import TextQuery
from fastsplat.service.settings import Settings
from fastsplat_client import Subscription
from fastsplat_contract.codec.proto_codec import to_proto
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.geometry.poses import pose_of
from fastsplat_contract.messages.queries import QueryOut, QueryRequest
from fastsplat_contract.messages.scenes import Edit
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import assert_same, client_of
from tests.api.made_scene import add_scene, turned
from tests.api.served import Faces, OwnQuestions, rpc_refusal, served
from tests.waiting import with_growing_limit

_ANGLES = [0.0, 0.1, -0.2, 0.3]


def _question(scene_id: str, *texts: str, **more: Any) -> QueryRequest:
    return QueryRequest(scene_id, texts, outputs=frozenset({"mask2d", "objects"}), **more)


class _Robot:
    """A stream whose requests are sent one by one."""

    def __init__(self, faces: Faces, **call: Any) -> None:
        self._requests: queue.Queue[pb.StreamQueryRequest | None] = queue.Queue()
        self.replies = faces.rpc.StreamQuery(iter(self._requests.get, None), **call)

    def ask(self, request: QueryRequest, heartbeat_s: float = 0.0) -> None:
        question = pb.Subscription(query=to_proto(request), heartbeat_s=heartbeat_s)
        self._requests.put(pb.StreamQueryRequest(question=question))

    def move(self, sequence: int, angle: float = 0.0, frame: str = "world") -> None:
        pose = pb.StreamPose(sequence=sequence, camera=to_proto(replace(turned(angle), frame_id=frame)))
        self._requests.put(pb.StreamQueryRequest(pose=pose))

    def leave(self) -> None:
        self._requests.put(None)

    def next(self, part: str) -> pb.StreamQueryResponse:
        """The next reply, which must be of that kind; heartbeats aside."""
        for reply in self.replies:
            if reply.WhichOneof("part") != "heartbeat":
                assert reply.WhichOneof("part") == part, reply
                return reply
        raise AssertionError("the stream ended")

    def refused(self) -> str:
        with pytest.raises(grpc.RpcError) as caught:
            list(self.replies)
        return rpc_refusal(caught.value).reason


@pytest.mark.parametrize(
    ("texts", "rankings"), [(("mug", "moon"), 1), (("mug left of the ball", "how many objects are red"), 2)]
)
def test_poses_are_answered_as_a_query_would_by_one_ranking_a_version(
    faces: Faces,
    service: SceneService,
    fresh_id: str,
    texts: tuple[str],
    rankings: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ranked, rank = list[TextQuery](), Ranker.rank
    monkeypatch.setattr(Ranker, "rank", lambda ranker, query: ranked.append(query) or rank(ranker, query))
    request, version = _question(fresh_id, *texts, mask2d_encoding="png"), service.versions.resolve(fresh_id)
    answered, cameras = threading.Semaphore(1), [turned(angle) for angle in 2 * _ANGLES]
    poses = (camera for camera in cameras if answered.acquire())  # a robot that waits for each answer misses none
    with client_of(faces) as client:
        stream = client.stream_query(Subscription(request), poses)
        for number, (camera, found) in enumerate(zip(cameras, stream, strict=True), start=1):
            assert len(ranked) == rankings
            alone = replace(request, cameras=(camera,), asker=pose_of(camera.world_from_camera))
            assert_same(found.answers, service.answers.query(alone).answers)
            del ranked[rankings:]
            assert (found.sequence, found.question, found.dropped) == (number, 1, 0)
            assert {answer.version for answer in found.answers} == {version}
            if number == len(_ANGLES):
                version = service.versions.edit(fresh_id, [Edit("name", object_ids=(1,), name="violin")]).version
                ranked.clear()
            answered.release()


class _Held(OwnQuestions):
    """A service whose questions with a camera wait until they are let go."""

    def __init__(self, service: SceneService) -> None:
        super().__init__(service)
        self.go = threading.Event()
        self.angles_seen: list[float] = []

    def query(self, request: QueryRequest, subscription: Any = None) -> QueryOut:
        if request.cameras:
            self.angles_seen.append(float(request.cameras[0].world_from_camera[0, 2]))
            self.begun.set()
            try:
                while not self.go.wait(0.01):
                    check_cancelled()
            except BaseException:
                self.stopped.set()
                raise
        return self._service.answers.query(request, subscription)


@pytest.fixture
def held(service: SceneService, api_settings: Settings) -> Iterator[tuple[_Held, Faces]]:
    slow = _Held(service)
    with served(slow, api_settings) as faces:
        yield slow, faces
        slow.go.set()


def test_of_a_burst_the_newest_pose_wins_and_every_other_number_is_announced(
    held: tuple[_Held, Faces], scene_id: str
) -> None:
    slow, faces = held
    robot = _Robot(faces)
    robot.ask(_question(scene_id, "mug"), heartbeat_s=0.3)
    robot.next("accepted")
    robot.move(1)
    assert slow.begun.wait(60)
    angles = np.linspace(0.01, 0.5, 500)
    for sequence, angle in enumerate(angles, start=10):
        robot.move(2 * sequence, angle)
    robot.leave()
    _settle(robot)
    slow.go.set()
    assert robot.next("response").sequence == 1
    robot.next("done")
    dropped = robot.next("dropped").dropped
    last = 2 * (9 + len(angles))
    assert (dropped.first, dropped.last, dropped.count) == (20, last - 2, len(angles) - 1)
    assert robot.next("response").sequence == last
    robot.next("done")
    assert list(robot.replies) == []
    assert slow.angles_seen == [pytest.approx(0.0), pytest.approx(np.sin(angles[-1]))]


def _settle(robot: _Robot) -> None:
    """Until the server has surely read all that was sent: three beats after the last was taken from the queue."""
    beats = 0
    while beats < 3:
        assert next(robot.replies).WhichOneof("part") == "heartbeat"
        beats += robot._requests.empty()


def test_a_deadline_stops_the_work_on_its_pose(held: tuple[_Held, Faces], scene_id: str) -> None:
    slow, faces = held

    def move(limit_s: float) -> bool | None:
        robot = _Robot(faces, timeout=limit_s)
        robot.ask(_question(scene_id, "mug"))
        robot.move(1)
        with pytest.raises(grpc.RpcError) as caught:
            list(robot.replies)
        assert caught.value.code() is grpc.StatusCode.DEADLINE_EXCEEDED
        return slow.begun.is_set() or None

    assert with_growing_limit(move, 0.3)
    assert slow.stopped.wait(60)


def test_a_silent_stream_beats_and_learns_that_its_scene_is_gone(
    faces: Faces, service: SceneService, api_settings: Settings
) -> None:
    scene_id = add_scene(service, api_settings, "short-lived")
    robot = _Robot(faces)
    robot.ask(_question(scene_id, "mug"), heartbeat_s=0.1)
    robot.next("accepted")
    for _ in range(2):
        assert next(robot.replies).WhichOneof("part") == "heartbeat"
    service.delete_scene(scene_id)
    assert robot.refused() == "NOT_FOUND"

    scene_id = add_scene(service, api_settings, "short-lived")

    def poses() -> Iterator[Any]:
        for angle in _ANGLES:
            yield turned(angle)
            deleted.wait(10)

    deleted = threading.Event()
    with client_of(faces) as client:
        answers = client.stream_query(Subscription(_question(scene_id, "mug")), poses())
        next(answers)
        service.delete_scene(scene_id)
        deleted.set()
        with pytest.raises(NotFoundError):
            list(answers)


@pytest.mark.parametrize(
    ("send", "field"),
    [
        (lambda robot, scene_id: robot.move(1), "question"),
        (lambda robot, scene_id: robot.ask(_question("", "mug")), "question.query"),
        (lambda robot, scene_id: robot.ask(_question(scene_id, "mug", cameras=(turned(0.0),))), "question.query"),
        (lambda robot, scene_id: robot.ask(_question("none", "mug")), "scene"),
        (lambda robot, scene_id: robot.ask(_question(scene_id, " ")), "text"),
        (
            lambda robot, scene_id: [robot.ask(_question(scene_id, "mug")), robot.move(2), robot.move(2)],
            "pose.sequence",
        ),
        (
            lambda robot, scene_id: [robot.ask(_question(scene_id, "mug")), robot.move(2, frame="kitchen")],
            "pose.camera.frame_id",
        ),
        (lambda robot, scene_id: robot.ask(_question(scene_id, "mug"), heartbeat_s=0.001), "question.heartbeat_s"),
        (lambda robot, scene_id: robot._requests.put(pb.StreamQueryRequest()), "part"),
    ],
)
def test_what_makes_no_sense_ends_the_stream_and_is_named(
    faces: Faces, scene_id: str, send: Callable[[_Robot, str], Any], field: str
) -> None:
    robot = _Robot(faces)
    send(robot, scene_id)
    with pytest.raises(grpc.RpcError) as caught:
        list(robot.replies)
    assert rpc_refusal(caught.value).details["field"] == field


def test_the_question_can_change_in_the_stream(faces: Faces, scene_id: str) -> None:
    robot = _Robot(faces)
    robot.ask(_question(scene_id, "mug"))
    assert robot.next("accepted").question == 1
    robot.move(7)
    assert robot.next("response").response.answer.text == "mug"
    assert robot.next("done").sequence == 7
    robot.ask(_question(scene_id, "ball"))
    assert robot.next("accepted").question == 2
    robot.move(8)
    reply = robot.next("response")
    assert (reply.response.answer.text, reply.sequence, reply.question) == ("ball", 8, 2)
    robot.next("done")
    robot.leave()
    assert list(robot.replies) == []
