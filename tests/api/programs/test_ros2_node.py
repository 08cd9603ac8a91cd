"""The node over a stand-in for rclpy: it publishes what a bag holds, follows new versions, and answers in words."""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_contract.geometry.places import Alignment
from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3
from fastsplat_contract.messages.scenes import Edit
from fastsplat_ros2.bag import BagMessages, types_with_vision
from fastsplat_ros2.snapshot import read_snapshot
from fastsplat_ros2.topics import TOPICS, published
from tests.api.fake_ros import FakeResponse, find_fields, install_fake_ros, is_rclpy_array
from tests.api.served import Faces
from tests.api.upright_scene import add_upright_scene


@pytest.fixture
def scene_id(service: SceneService, api_settings: Settings) -> str:
    return add_upright_scene(service, api_settings)


@pytest.fixture
def parameters(faces: Faces, scene_id: str) -> dict[str, Any]:
    return {"server": str(faces.rest.base_url), "scene": scene_id}


@pytest.fixture
def node(parameters: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    install_fake_ros(monkeypatch, parameters)
    monkeypatch.delitem(sys.modules, "fastsplat_ros2.node", raising=False)
    scene_node = importlib.import_module("fastsplat_ros2.node").SceneNode()
    yield scene_node
    scene_node._client.close()
    monkeypatch.delitem(sys.modules, "fastsplat_ros2.node", raising=False)


def _plain(message: Any) -> Any:
    if hasattr(message, "__dataclass_fields__"):
        return {name: _plain(getattr(message, name)) for name in message.__dataclass_fields__}
    if isinstance(message, list):
        return [_plain(part) for part in message]
    return np.asarray(message).tolist()


def _find(node: Any, text: str) -> FakeResponse:
    response: FakeResponse = node.services["find"](SimpleNamespace(text=text), FakeResponse())
    return response


def test_the_node_publishes_what_a_bag_holds(node: Any, client: Client, scene_id: str) -> None:
    expected = dict(published(BagMessages(types_with_vision()), read_snapshot(client, scene_id)))
    assert {topic for topic, _ in node.published} == set(expected) == set(TOPICS)
    for topic, message in node.published:
        assert _plain(message) == _plain(expected[topic]), topic
    messages = dict(node.published)
    assert is_rclpy_array(messages["/map"].data) and is_rclpy_array(messages["/fastsplat/points"].data)
    assert node.log == []


def test_a_new_version_is_published_once(node: Any, service: SceneService, scene_id: str) -> None:
    ((period, look),) = node.timers
    before = len(node.published)
    look()
    assert period == 5.0 and len(node.published) == before
    pose = Pose(Vector3(1.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
    service.versions.edit(scene_id, (Edit("align", alignment=Alignment("hall", pose)),), "", "")
    look()
    look()
    new = dict(node.published[before:])
    assert len(node.published) == before + len(new) and set(new) == {*TOPICS, "/tf_static"}
    assert new["/tf_static"].header.frame_id == "hall" == new["/map"].header.frame_id


def test_questions_are_answered_with_detections_or_refused_in_words(node: Any, client: Client, scene_id: str) -> None:
    mug = _find(node, "mug")
    (answer,) = client.query(scene_id, "mug")
    said = vars(mug)
    assert (said["success"], said["outcome"], said["message"]) == (True, answer.outcome, answer.sentence)
    assert [detection.id for detection in said["detections"].detections] == ["1"] and said["version"] == answer.version
    absent = vars(_find(node, "elephant"))
    assert absent["success"] and absent["outcome"] == "not_here" and absent["detections"].detections == []
    refused = vars(_find(node, ""))
    assert not refused["success"] and math.isnan(refused["probability"])
    assert refused["message"].startswith("INVALID_INPUT: an empty text")


def test_a_scene_that_is_not_there_is_said_in_the_log(node: Any, parameters: dict[str, Any]) -> None:
    parameters["scene"] = "0" * 32
    other_node = type(node)()
    assert other_node.published == [] and other_node.log[0][1].startswith("NOT_FOUND")
    assert vars(_find(other_node, "mug"))["success"] is False
    other_node._client.close()


def test_the_service_has_the_fields_that_the_node_fills() -> None:
    request, response = find_fields()
    assert request == {"text": "string"}
    assert response["detections"] == "vision_msgs/Detection3DArray" and response["probability"] == "float64"
