"""A scene as ROS 2 messages, in a bag and by the node over a stand-in for rclpy: both say what the service said."""

from __future__ import annotations

import dataclasses
import importlib
import io
import math
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_client import Client, DetectionList, InvalidInputError, NotFoundError
from fastsplat_contract.geometry.places import Alignment
from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3
from fastsplat_contract.messages.objects import NameSuggestion
from fastsplat_contract.messages.scenes import Edit
from fastsplat_ros2 import messages
from fastsplat_ros2.bag import BagMessages, main, types_with_vision, write_bag
from fastsplat_ros2.snapshot import Snapshot, read_snapshot
from fastsplat_ros2.topics import TOPICS, published
from tests.api.fake_ros import FakeResponse, find_fields, install_fake_ros, is_rclpy_array
from tests.api.served import Faces
from tests.api.upright_scene import add_upright_scene

_QUARTER = Pose(Vector3(2.0, -1.0, 0.5), Quaternion(0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
_MAKE = BagMessages(types_with_vision())


@pytest.fixture(scope="module")
def aligned_id(service: SceneService, api_settings: Settings) -> str:
    scene_id = add_upright_scene(service, api_settings)
    service.versions.edit(scene_id, (Edit("align", alignment=Alignment("hall", _QUARTER)),), "", "")
    return scene_id


@pytest.fixture
def snapshot(client: Client, upright_id: str) -> Snapshot:
    return read_snapshot(client, upright_id)


def _read(folder: Path) -> dict[str, tuple[int, Any]]:
    with AnyReader([folder], default_typestore=types_with_vision()) as reader:
        return {
            connection.topic: (at, reader.deserialize(raw, connection.msgtype))
            for connection, at, raw in reader.messages()
        }


def _values(message: Any) -> tuple[float, ...]:
    return tuple(getattr(message, name) for name in ("x", "y", "z", "w") if hasattr(message, name))


def test_every_field_of_a_detection_comes_back(snapshot: Snapshot, tmp_path: Path) -> None:
    topics = write_bag(snapshot, tmp_path / "bag")
    assert topics == list(TOPICS)  # without a transform: this scene was put into no map
    at, array = _read(tmp_path / "bag")["/fastsplat/detections"]
    assert at == snapshot.stamp_ns == array.header.stamp.sec * 10**9 + array.header.stamp.nanosec
    assert array.header.frame_id == snapshot.detections.frame_id == "world"
    assert [sent.id for sent in array.detections] == [str(truth.object_id) for truth in snapshot.detections.detections]
    for sent, truth in zip(array.detections, snapshot.detections.detections, strict=True):
        assert truth.box is not None and sent.header == array.header
        for pose in (sent.bbox.center, *(result.pose.pose for result in sent.results)):
            assert _values(pose.position) == tuple(truth.box.center.position)
            assert _values(pose.orientation) == tuple(truth.box.center.orientation)
        assert _values(sent.bbox.size) == tuple(truth.box.size)
        hypotheses = [(result.hypothesis.class_id, result.hypothesis.score) for result in sent.results]
        alternatives = [(name, probability) for name, probability, _ in truth.alternatives]
        assert hypotheses == [*([(truth.label, truth.probability)] if truth.label else []), *alternatives]
        for result in sent.results:
            covariance = result.pose.covariance.reshape(6, 6)
            known = ~np.isnan(truth.covariance())
            np.testing.assert_array_equal(covariance[known], truth.covariance()[known])
            assert np.linalg.eigvalsh(covariance).min() >= 0


def test_what_is_not_known_is_neither_sure_nor_zero(snapshot: Snapshot) -> None:
    first = snapshot.detections.detections[0]
    round_object = dataclasses.replace(
        first, rotation_covariance=(), label="", probability=None, alternatives=(NameSuggestion("cup", 0.4),)
    )
    unseen = dataclasses.replace(first, object_id=99, box=None)
    page = snapshot.detections._replace(detections=(round_object, unseen))
    (sent,) = messages.detection_array(_MAKE, page, 5).detections
    assert [(result.hypothesis.class_id, result.hypothesis.score) for result in sent.results] == [("cup", 0.4)]
    covariance = sent.results[0].pose.covariance.reshape(6, 6)
    np.testing.assert_allclose(covariance[3:, 3:], math.pi**2 / 3 * np.eye(3))
    assert not covariance[:3, 3:].any()
    with pytest.raises(InvalidInputError, match="unit is arbitrary"):
        messages.detection_array(_MAKE, page._replace(meters=False), 5)


def test_points_come_back_with_labels_and_objects(snapshot: Snapshot, tmp_path: Path) -> None:
    write_bag(snapshot, tmp_path / "bag")
    cloud = _read(tmp_path / "bag")["/fastsplat/points"][1]
    rows = messages.ply_rows(snapshot.points)
    kinds = {7: "<f4", 4: "<u2"}
    layout = np.dtype(
        {
            "names": [field.name for field in cloud.fields],
            "formats": [kinds[field.datatype] for field in cloud.fields],
            "offsets": [field.offset for field in cloud.fields],
            "itemsize": cloud.point_step,
        }
    )
    points = np.frombuffer(cloud.data.tobytes(), layout)
    assert cloud.width == len(rows) > 100 and cloud.height == 1 and cloud.row_step == cloud.data.nbytes
    for name in ("x", "y", "z", "label", "object"):
        np.testing.assert_array_equal(points[name], rows[name])
    packed = points["rgb"].copy().view(np.uint32)
    for name, shift in (("red", 16), ("green", 8), ("blue", 0)):
        np.testing.assert_array_equal(packed >> shift & 255, rows[name])
    assert set(points["object"].tolist()) >= {1, 2}


def test_the_map_is_what_map_server_makes_of_the_files(snapshot: Snapshot, tmp_path: Path) -> None:
    write_bag(snapshot, tmp_path / "bag")
    grid = _read(tmp_path / "bag")["/map"][1]
    assert snapshot.floor_map is not None
    with zipfile.ZipFile(io.BytesIO(snapshot.floor_map)) as files:
        facts = yaml.safe_load(files.read("map.yaml"))
        pixels = messages.pgm_pixels(files.read("map.pgm"))
    cells = grid.data.reshape(grid.info.height, grid.info.width)
    words = {254: 0, 0: 100, 205: -1}
    assert cells[::-1].tolist() == [[words[pixel] for pixel in row] for row in pixels.tolist()]
    assert {0, 100, -1} == set(cells.ravel().tolist())
    assert grid.info.resolution == pytest.approx(facts["resolution"])
    assert _values(grid.info.origin.position) == (*facts["origin"][:2], 0.0)
    assert _values(grid.info.origin.orientation) == (0.0, 0.0, 0.0, 1.0)


def test_the_map_is_the_parent_of_the_scene_as_it_was_trained(
    client: Client, upright_id: str, aligned_id: str, tmp_path: Path
) -> None:
    snapshot = read_snapshot(client, aligned_id)
    assert write_bag(snapshot, tmp_path / "bag") == [*TOPICS, "/tf_static"]
    read = _read(tmp_path / "bag")
    (transform,) = read["/tf_static"][1].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("hall", "scene")
    assert {message.header.frame_id for topic, (_, message) in read.items() if topic != "/tf_static"} == {"hall"}
    motion = Pose(
        Vector3(*_values(transform.transform.translation)), Quaternion(*_values(transform.transform.rotation))
    ).matrix()
    before = {detection.object_id: detection.box for detection in client.detections(upright_id)}
    for sent in read["/fastsplat/detections"][1].detections:
        trained = before[int(sent.id)]
        assert trained is not None
        expected = motion @ [*trained.center.position, 1.0]
        np.testing.assert_allclose(_values(sent.bbox.center.position), expected[:3], atol=0.02)


def test_a_scene_without_a_vertical_is_shown_without_a_map(
    client: Client, service: SceneService, aligned_id: str, tmp_path: Path
) -> None:
    tilted = Pose(Vector3(0.0, 0.0, 0.0), Quaternion(math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)))
    service.versions.edit(aligned_id, (Edit("align", alignment=Alignment("hall", tilted)),), "", "")
    try:
        snapshot = read_snapshot(client, aligned_id)
        assert snapshot.floor_map is None and "z axis" in snapshot.no_map
        assert "/map" not in write_bag(snapshot, tmp_path / "bag")
    finally:
        service.versions.undo(aligned_id)


def test_what_answers_a_question_is_found_among_the_detections(client: Client, snapshot: Snapshot) -> None:
    (answer,) = client.query(snapshot.scene.id, "mug", outputs=["objects"])
    page = messages.found(snapshot.detections, answer)
    assert [detection.object_id for detection in page.detections] == list(answer.object_ids) == [1]
    (absent,) = client.query(snapshot.scene.id, "elephant", outputs=["objects"])
    assert messages.found(snapshot.detections, absent).detections == ()


def test_pages_are_put_together(snapshot: Snapshot) -> None:
    page: DetectionList = snapshot.detections
    assert len(page.detections) == 2
    first, two = (page._replace(detections=(detection,), next_page_token="more") for detection in page.detections)
    assert messages.whole([first, two._replace(next_page_token="")]) == page


def test_the_command_writes_a_bag_of_a_server(
    faces: Faces, snapshot: Snapshot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server = str(faces.rest.base_url)
    assert main([snapshot.scene.id, str(tmp_path / "bag"), "--server", server]) == 0
    assert capsys.readouterr().out.split() == list(TOPICS)
    assert set(_read(tmp_path / "bag")) == set(TOPICS)
    assert main([snapshot.scene.id, str(tmp_path / "bag"), "--server", server]) == 1
    assert "is there already" in capsys.readouterr().err
    assert main(["0" * 32, str(tmp_path / "other"), "--server", server]) == 1
    assert capsys.readouterr().err.startswith(NotFoundError.reason)
    assert not (tmp_path / "other").exists()


@pytest.fixture
def node_scene_id(service: SceneService, api_settings: Settings) -> str:
    return add_upright_scene(service, api_settings)


@pytest.fixture
def parameters(faces: Faces, node_scene_id: str) -> dict[str, Any]:
    return {"server": str(faces.rest.base_url), "scene": node_scene_id}


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


def test_the_node_publishes_what_a_bag_holds(node: Any, client: Client, node_scene_id: str) -> None:
    expected = dict(published(BagMessages(types_with_vision()), read_snapshot(client, node_scene_id)))
    assert {topic for topic, _ in node.published} == set(expected) == set(TOPICS)
    for topic, message in node.published:
        assert _plain(message) == _plain(expected[topic]), topic
    messages = dict(node.published)
    assert is_rclpy_array(messages["/map"].data) and is_rclpy_array(messages["/fastsplat/points"].data)
    assert node.log == []


def test_a_new_version_is_published_once(node: Any, service: SceneService, node_scene_id: str) -> None:
    ((period, look),) = node.timers
    before = len(node.published)
    look()
    assert period == 5.0 and len(node.published) == before
    pose = Pose(Vector3(1.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
    service.versions.edit(node_scene_id, (Edit("align", alignment=Alignment("hall", pose)),), "", "")
    look()
    look()
    new = dict(node.published[before:])
    assert len(node.published) == before + len(new) and set(new) == {*TOPICS, "/tf_static"}
    assert new["/tf_static"].header.frame_id == "hall" == new["/map"].header.frame_id


def test_questions_are_answered_with_detections_or_refused_in_words(
    node: Any, client: Client, node_scene_id: str
) -> None:
    mug = _find(node, "mug")
    (answer,) = client.query(node_scene_id, "mug")
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
