"""A stream of answers outlives its server, killed for real in mid-stream, and its connection, cut again and again."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from fastsplat.service.application.service import open_service
from fastsplat.service.settings import Settings
from fastsplat_client import (
    Answer,
    Client,
    NotFoundError,
    PoseAnswer,
    QueryRequest,
    Reconnect,
    Subscription,
    UnauthenticatedError,
    UnreachableError,
)
from release.check_wheels import free_ports
from tests.api.clients import assert_same
from tests.api.guarded import Guarded
from tests.api.line import Line
from tests.api.made_scene import add_scene, turned
from tests.api.served import Faces
from tests.api.server_process import server_process
from tests.waiting import wait_for

_ANGLES = (0.0, 0.1, -0.2, 0.3, -0.1, 0.2)
_QUICK = Reconnect(tries=2000, first_s=0.05, most_s=0.2)  # however slowly the server starts


@dataclass(frozen=True)
class _Pauses(Reconnect):
    """Tells of each pause before a new connection."""

    report: Callable[[int], object] = print

    def pause(self, attempt: int) -> float:
        self.report(attempt)
        return super().pause(attempt)


def _question(scene_id: str, *texts: str) -> Subscription:
    return Subscription(QueryRequest(scene_id, texts, outputs=frozenset({"mask2d"}), mask2d_encoding="png"))


def _stored(settings: Settings) -> tuple[str, dict[float, tuple[Answer, ...]]]:
    """A scene, and what is to be answered from each angle."""
    with open_service(settings) as service:
        scene_id = add_scene(service, settings)
        expected = {}
        for angle in _ANGLES:
            request = replace(_question(scene_id, "mug", "moon").request, cameras=(turned(angle),))
            expected[angle] = service.answers.query(request).answers
    return scene_id, expected


@pytest.fixture
def line(faces: Faces) -> Iterator[Line]:
    """The way to the server of all tests."""
    line = Line(faces.ports.grpc)
    yield line
    line.take_down()


def _client(faces: Faces, line: Line, key: str = "") -> Client:
    return Client(str(faces.rest.base_url), key=key, grpc_target=f"127.0.0.1:{line.port}")


class _Walk:
    """Poses of which each is sent once the one before is answered; before some of them something happens."""

    def __init__(self, parts: list[Any], before: dict[int, Callable[[], object]]) -> None:
        self._parts = parts
        self._before = before
        self.answered = threading.Semaphore(1)

    def __iter__(self) -> Iterator[Any]:
        for number, part in enumerate(self._parts, start=1):
            self.answered.acquire()
            self._before.get(number, lambda: None)()
            yield turned(part) if isinstance(part, float) else part
            if not isinstance(part, float):
                self.answered.release()


def _answers(client: Client, question: Subscription, walk: _Walk, reconnect: Reconnect) -> list[PoseAnswer]:
    found = []
    for answer in client.stream_query(question, walk, reconnect=reconnect):
        found.append(answer)
        walk.answered.release()
    return found


def test_each_pose_is_answered_once_though_the_server_is_killed_between(api_settings: Settings, tmp_path: Path) -> None:
    ports = dict(zip(("http_port", "grpc_port", "metrics_port"), free_ports(3), strict=True))  # the same for both
    settings = api_settings.model_copy(update={"data_dir": tmp_path / "data", **ports})
    scene_id, expected = _stored(settings)
    with ExitStack() as stack:
        server = stack.enter_context(server_process(settings))

        def again() -> None:
            server.process.kill()
            server.process.wait()
            stack.enter_context(server_process(settings))

        walk = _Walk(list(_ANGLES), {3: again})
        with Client(server.url, grpc_target=server.grpc_target) as client:
            found = _answers(client, _question(scene_id, "mug", "moon"), walk, _QUICK)
    assert [answer.sequence for answer in found] == [1, 2, 3, 4, 5, 6]
    assert [answer.dropped for answer in found] == [0] * 6 and {answer.question for answer in found} == {1}
    assert [answer.reconnected > 0 for answer in found] == [False, False, True, False, False, False]
    for answer, angle in zip(found, _ANGLES, strict=True):
        assert_same(answer.answers, expected[angle])


def test_poses_that_went_with_the_connection_are_counted_and_none_is_answered_twice(
    faces: Faces, line: Line, scene_id: str
) -> None:
    count = 400
    half = threading.Event()

    def poses() -> Iterator[Any]:
        for number in range(count):
            if number == count // 2:
                assert half.wait(60)  # at least one answer came
                line.cut()
            yield turned(0.001 * number)

    found = []
    with _client(faces, line) as client:
        for answer in client.stream_query(_question(scene_id, "mug"), poses(), reconnect=_QUICK):
            found.append(answer)
            half.set()
    numbers = [answer.sequence for answer in found]
    assert numbers == sorted(set(numbers)) and numbers[-1] == count
    assert sum(answer.dropped + 1 for answer in found) == count
    assert sum(answer.reconnected for answer in found) > 0


def test_the_question_that_stands_is_asked_again(faces: Faces, line: Line, scene_id: str) -> None:
    walk = _Walk([0.0, _question(scene_id, "ball"), 0.1, 0.2, 0.3], {2: line.cut, 4: line.cut})
    with _client(faces, line) as client:
        found = _answers(client, _question(scene_id, "mug"), walk, _QUICK)
    assert [(answer.sequence, answer.question, answer.answers[0].text) for answer in found] == [
        (1, 1, "mug"),
        (2, 2, "ball"),
        (3, 2, "ball"),
        (4, 2, "ball"),
    ]
    assert sum(answer.reconnected for answer in found) >= 2


def test_tries_are_bounded(faces: Faces, line: Line, scene_id: str) -> None:
    attempts: list[int] = []
    bounded = _Pauses(tries=3, first_s=0.01, most_s=0.02, report=attempts.append)
    with _client(faces, line) as client, pytest.raises(UnreachableError):
        _answers(client, _question(scene_id, "mug"), _Walk([0.0, 0.1], {2: line.take_down}), bounded)
    assert attempts == [0, 1, 2]
    with _client(faces, line) as client, pytest.raises(UnreachableError):  # never reached: nothing to go on with
        _answers(client, _question(scene_id, "mug"), _Walk([0.0], {}), bounded)
    assert attempts == [0, 1, 2]


def test_a_server_that_refuses_the_key_or_lacks_the_scene_ends_the_stream(guarded: Guarded) -> None:
    scene_id, keys = guarded.shared["scene_id"], guarded.service.admin.keys
    record, key = keys.create("robot", "reader")
    line = Line(guarded.faces.ports.grpc)

    def refused() -> bool:
        header = {"Authorization": f"Bearer {key}"}
        return guarded.faces.rest.get("/v1/scenes", headers=header).status_code == 401

    def revoked() -> None:
        line.take_down()
        keys.revoke(record.id)
        wait_for(refused)
        line.bring_up()

    attempts: list[int] = []
    pauses = _Pauses(tries=2000, first_s=0.05, most_s=0.2, report=attempts.append)
    walk = _Walk([0.0, 0.1, 0.2], {2: revoked})
    with _client(guarded.faces, line, key) as client, pytest.raises(UnauthenticatedError):
        _answers(client, _question(scene_id, "mug"), walk, pauses)
    assert attempts == list(range(len(attempts))) and attempts
    with _client(guarded.faces, line, guarded.keys["reader"]) as client, pytest.raises(NotFoundError):
        _answers(client, _question("none", "mug"), _Walk([0.0], {}), pauses)
    line.take_down()


def test_a_network_that_fell_silent_is_noticed(faces: Faces, line: Line, scene_id: str) -> None:
    reconnect = Reconnect(tries=2000, silence_s=1.0)
    with _client(faces, line) as client:
        found = _answers(client, _question(scene_id, "mug"), _Walk([0.0, 0.1], {2: line.silence}), reconnect)
    assert [answer.sequence for answer in found] == [1, 2] and found[1].reconnected > 0


def test_an_error_of_the_poses_is_raised_as_it_is(client: Client, scene_id: str) -> None:
    def poses() -> Iterator[Any]:
        yield turned(0.0)
        raise ValueError("the odometry is gone")

    found: list[int] = []
    with pytest.raises(ValueError, match="odometry"):
        found.extend(answer.sequence for answer in client.stream_query(_question(scene_id, "mug"), poses()))
    assert found == [1]
