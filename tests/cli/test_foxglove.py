"""`fastsplat scenes foxglove`, as a real WebSocket client sees it: channels, messages decoded by their own schemas."""

from __future__ import annotations

import base64
import io
import json
import os
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory
from typer.testing import CliRunner
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from fastsplat.cli.main import app
from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import load_settings
from fastsplat_contract.errors import MissingPackageError, NotFoundError, ResourceError
from fastsplat_contract.exports import ExportRequest
from fastsplat_contract.scenes import Edit
from tests.api.made_scene import add_scene
from tests.api.served import served
from tests.api.upright_scene import add_upright_scene

_PATIENCE_S = 120.0
_MESSAGE = struct.Struct("<BIQ")
"""What is before the content of a binary message: its kind, the subscription, nanoseconds since 1970."""


@contextmanager
def _showing(scene_id: str, *more: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command, and its address."""
    options = ["--port", "0", "--camera-s", "0.05", *more]
    process = subprocess.Popen(
        [sys.executable, "-m", "fastsplat.cli.main", "scenes", "foxglove", scene_id, *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    try:
        assert process.stdout is not None
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.communicate()


class _Viewer:
    """What Foxglove does: it reads which channels there are, subscribes, and decodes by the channel's schema."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self.server = json.loads(connection.recv(_PATIENCE_S))
        self.channels: dict[str, dict[str, Any]] = {}
        self.advertisements = 0
        self._subscribed: dict[int, str] = {}
        self._decoders: dict[str, Any] = {}

    def advertised(self, *topics: str) -> None:
        """Read until these topics are there."""
        while not set(topics) <= set(self.channels):
            self._read()

    def subscribe(self, *topics: str) -> None:
        self.advertised(*topics)
        asked = []
        for topic in topics:
            channel = self.channels[topic]
            asked.append({"id": channel["id"], "channelId": channel["id"]})
            self._subscribed[channel["id"]] = topic
            if channel["encoding"] == "protobuf":
                definition = base64.b64decode(channel["schema"])
                schema = Schema(channel["id"], definition, channel["schemaEncoding"], channel["schemaName"])
                self._decoders[topic] = DecoderFactory().decoder_for("protobuf", schema)
            else:
                self._decoders[topic] = json.loads
        self._connection.send(json.dumps({"op": "subscribe", "subscriptions": asked}))

    def next(self, topic: str) -> Any:
        """The next message of a topic."""
        while True:
            if (read := self._read()) is not None and read[0] == topic:
                return read[1]

    def _read(self) -> tuple[str, Any] | None:
        received = self._connection.recv(_PATIENCE_S)
        if isinstance(received, str):
            said = json.loads(received)
            assert said["op"] != "status", said["message"]  # as that it subscribed to what the server does not know
            if said["op"] == "advertise":
                self.advertisements += 1
                self.channels |= {channel["topic"]: channel for channel in said["channels"]}
            return None
        kind, subscription, at = _MESSAGE.unpack_from(received)
        if kind != 1:
            return None
        topic = self._subscribed[subscription]
        message = self._decoders[topic](received[_MESSAGE.size :])
        if hasattr(message, "timestamp"):
            assert message.timestamp.ToNanoseconds() == at
        return topic, message


@contextmanager
def _viewing(address: str) -> Iterator[_Viewer]:
    with connect(address, subprotocols=[Subprotocol("foxglove.sdk.v1")], max_size=None) as connection:
        assert connection.subprotocol == "foxglove.sdk.v1"
        yield _Viewer(connection)


def _of_file(service: SceneService, scene_id: str) -> tuple[dict[str, list[Any]], dict[str, Any]]:
    """Messages by topic, and metadata, of the same scene's file."""
    content = service.exports.file(ExportRequest(scene_id, "mcap"))
    reader = make_reader(io.BytesIO(content), decoder_factories=[DecoderFactory()])
    read: dict[str, list[Any]] = {}
    for _, channel, _, decoded in reader.iter_decoded_messages():
        read.setdefault(channel.topic, []).append(decoded)
    return read, {record.name: dict(record.metadata) for record in reader.iter_metadata()}


def _without_time(message: Any) -> Any:
    for each in (message, *getattr(message, "entities", ())):
        each.ClearField("timestamp") if "timestamp" in each.DESCRIPTOR.fields_by_name else None
    if hasattr(message, "deletions"):
        message.ClearField("deletions")
    return message


def _same(one: Any, other: Any) -> bool:
    """Decoded by different copies of one schema."""
    return bool(
        _without_time(one).SerializeToString(deterministic=True)
        == _without_time(other).SerializeToString(deterministic=True)
    )


@pytest.mark.parametrize("make", [add_scene, add_upright_scene])
def test_all_that_the_file_holds_is_there_for_whoever_comes(service: SceneService, make: Any) -> None:
    scene_id = make(service, load_settings())
    read, about = _of_file(service, scene_id)
    assert ("/map" in read) == (make is add_upright_scene) == ("no_map" not in about["scene"])
    with _showing(scene_id) as (process, address):
        for _ in range(2):  # the second one comes when everything was sent once
            with _viewing(address) as viewer:
                viewer.subscribe(*read, "/scene")
                assert set(viewer.channels) == {*read, "/scene"}
                for topic in set(read) - {"/tf", "/camera/calibration", "/camera/image"}:
                    with _viewing(address) as another:
                        another.subscribe(topic)
                        assert _same(another.next(topic), read[topic][0]), topic
                assert viewer.next("/scene") == about
                _check_cameras(viewer, read)
        process.send_signal(signal.SIGTERM)
        assert process.wait(_PATIENCE_S) == 0


def _check_cameras(viewer: _Viewer, read: dict[str, list[Any]]) -> None:
    """One after the other, in their order, beginning anywhere, and after the last one the first."""
    count = len(read["/camera/calibration"])
    poses = [_numbers(transform) for transform in read["/tf"]]
    seen: list[int] = []
    while len(seen) < 2 * count:
        number = poses.index(_numbers(viewer.next("/tf")))
        if seen[-1:] != [number]:  # who subscribes gets the one of the moment, which may have come already
            seen.append(number)
    assert seen == [(seen[0] + number) % count for number in range(2 * count)]


def _numbers(transform: Any) -> tuple[float, ...]:
    there, turn = transform.translation, transform.rotation
    return there.x, there.y, there.z, turn.x, turn.y, turn.z, turn.w


def test_every_topic_is_there_before_anybody_can_come(service: SceneService) -> None:
    """The package loses subscriptions of a viewer that is quicker than a new channel, and never sends it anything."""
    scene_id = add_scene(service, load_settings())
    read, _ = _of_file(service, scene_id)
    with _showing(scene_id) as (_, address), _viewing(address) as viewer:
        viewer.advertised("/scene")
        assert set(viewer.channels) == {*read, "/scene"}
        assert viewer.advertisements == 1


def test_photos_are_those_of_the_file(service: SceneService) -> None:
    scene_id = add_scene(service, load_settings())
    read, _ = _of_file(service, scene_id)
    with _showing(scene_id) as (_, address), _viewing(address) as viewer:
        viewer.subscribe("/camera/image")
        photos = {viewer.next("/camera/image").data for _ in range(6)}
    assert photos == {image.data for image in read["/camera/image"]} and len(photos) == 3


def test_an_edit_appears_without_a_restart(service: SceneService) -> None:
    scene_id = add_scene(service, load_settings())
    with _showing(scene_id) as (_, address), _viewing(address) as viewer:
        viewer.subscribe("/things", "/scene")
        before = viewer.next("/things")
        assert "mug" in _names(before)
        service.versions.edit(scene_id, [Edit("name", things=(1,), name="beaker")])
        after = viewer.next("/things")
        while "mug" in _names(after):
            after = viewer.next("/things")
        assert "beaker" in _names(after)
        (deletion,) = after.deletions
        assert deletion.type == type(deletion).ALL and deletion.timestamp == after.entities[0].timestamp
        about = viewer.next("/scene")
        while "mug" in about["things"].values():
            about = viewer.next("/scene")
        assert about["scene"]["version"] == service.versions.resolve(scene_id)


def _names(update: Any) -> Sequence[str]:
    return [text.text for entity in update.entities for text in entity.texts]


def test_the_scene_of_a_server_is_followed_until_it_is_gone(service: SceneService) -> None:
    settings = load_settings().model_copy(update={"auth": "off", "http_port": 0, "grpc_port": 0, "metrics_port": 0})
    scene_id = add_scene(service, settings)
    with (
        served(service, settings) as faces,
        _showing(scene_id, "--server", str(faces.rest.base_url)) as (process, address),
    ):
        with _viewing(address) as viewer:
            viewer.subscribe("/points", "/things")
            assert len(viewer.next("/points").data) > 1000
            service.versions.edit(scene_id, [Edit("name", things=(2,), name="sphere")])
            while "sphere" not in _names(viewer.next("/things")):
                pass
        service.delete_scene(scene_id)
        assert process.wait(_PATIENCE_S) == 2
        assert process.stderr is not None and "NOT_FOUND" in process.stderr.read()


def test_what_cannot_be_shown_is_said_at_once(service: SceneService, monkeypatch: pytest.MonkeyPatch) -> None:
    scene_id = add_scene(service, load_settings())
    result = CliRunner().invoke(app, ["scenes", "foxglove", "none", "--port", "0"])
    assert isinstance(result.exception, NotFoundError)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        result = CliRunner().invoke(app, ["scenes", "foxglove", scene_id, "--port", str(port)])
    assert isinstance(result.exception, ResourceError) and str(port) in result.exception.message
    monkeypatch.delitem(sys.modules, "fastsplat.service.application.exporting.foxglove_live", raising=False)
    monkeypatch.setitem(sys.modules, "mcap_protobuf.decoder", None)
    result = CliRunner().invoke(app, ["scenes", "foxglove", scene_id])
    assert isinstance(result.exception, MissingPackageError)
    assert "fastsplat[foxglove]" in result.exception.hint and "mcap-protobuf-support" in result.exception.message
