"""A scene over Foxglove's WebSocket: what its MCAP file holds, as it is now.

This module needs the optional package mcap-protobuf-support.

The messages are those of `foxglove_file`; that is the one place where they are made. Here they get the time of the
moment: what does not move is sent to who subscribes and again with each new version, and the cameras follow one another
without end.
"""

from __future__ import annotations

import io
import json
import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from foxglove import Channel, Context, Schema, start_server
from foxglove.websocket import ChannelView, Client, ServerListener
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from fastsplat_contract.errors import FastSplatError, Kind, ResourceError

SCENE_TOPIC = "/scene"
"""The metadata of the file, as JSON: `scene`, `labels` and `things`."""

_CAMERA_TOPICS = ("/camera/calibration", "/camera/image")
_TRANSFORMS = "/tf"

_MOST_WAIT_S = 0.5
"""Until `stop` is looked at."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Topic:
    """A topic of a file.

    Attributes:
        schema: name, encoding and definition of its messages.
        message_encoding: "protobuf".
    """

    schema: Schema
    message_encoding: str


@dataclass(frozen=True)
class Recorded:
    """An MCAP file of a scene, taken apart.

    Attributes:
        topics: by their name.
        still: messages of what does not move, by topic, as protobuf has decoded them.
        cameras: for each camera its messages, as pairs of topic and message.
        about: the file's metadata, by the record's name.
    """

    topics: Mapping[str, Topic]
    still: Mapping[str, Sequence[Any]]
    cameras: Sequence[Sequence[tuple[str, Any]]]
    about: Mapping[str, Mapping[str, str]]


def recorded(content: bytes) -> Recorded:
    """Take apart a file of `foxglove_file`."""
    topics: dict[str, Topic] = {}
    still: dict[str, list[Any]] = {}
    cameras: dict[int, list[tuple[str, Any]]] = {}
    reader = make_reader(io.BytesIO(content), decoder_factories=[DecoderFactory()])
    for schema, channel, message, decoded in reader.iter_decoded_messages():
        assert schema is not None, "foxglove_file gives every channel a schema"
        if channel.topic not in topics:
            described = Schema(name=schema.name, encoding=schema.encoding, data=schema.data)
            topics[channel.topic] = Topic(described, channel.message_encoding)
        if channel.topic in _CAMERA_TOPICS or (channel.topic == _TRANSFORMS and _is_of_camera(decoded)):
            cameras.setdefault(message.log_time, []).append((channel.topic, decoded))
        else:
            still.setdefault(channel.topic, []).append(decoded)
    about = {record.name: record.metadata for record in reader.iter_metadata()}
    return Recorded(topics, still, [cameras[at] for at in sorted(cameras)], about)


class LiveScene:
    """A scene that Foxglove shows. A context manager; all its calls come from one thread, as `follow` makes them.

    Args:
        name: of the server, as Foxglove shows it.
        host: the address to listen at. Whoever reaches it sees the scene; there are no keys.
        port: 0 takes a free one.
        clock: nanoseconds since 1970.
        content: the file of `foxglove_file` that is shown first.

    Raises:
        ResourceError: the port cannot be had.
    """

    def __init__(self, name: str, host: str, port: int, clock: Callable[[], int], content: bytes) -> None:
        self._clock = clock
        # The package tells of a subscription while it holds locks of its own, which sending needs, too.
        self._subscribed: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._context = Context()
        self._channels: dict[str, Channel] = {}
        self._shown: Recorded | None = None
        self._camera = -1
        # Before anybody can connect. The package tells a viewer of a new channel a moment before it takes subscriptions
        # to it, so one that is quick is refused and would wait for ever; for what is there already it has no such gap.
        self.show(content)
        try:
            self._server = start_server(
                name=name,
                host=host,
                port=port,
                context=self._context,
                server_listener=_Subscriptions(self._subscribed.put),
            )
        except Exception as error:  # the package raises RuntimeError or its own
            raise ResourceError(
                f"{host}:{port} cannot be listened at: {error}", field="port", hint="Choose another port."
            ) from error

    def __enter__(self) -> LiveScene:
        return self

    def __exit__(self, *exception: object) -> None:
        self._server.stop()

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._server.port

    @property
    def app_url(self) -> str:
        """Of Foxglove's web application, which then connects here."""
        return self._server.app_url() or ""

    def show(self, content: bytes) -> None:
        """Show a file of `foxglove_file` from now on, in place of the one before; topics it lacks are taken back.

        A topic that the one before lacked may be missed by a viewer that is here already, until it connects again.
        """
        shown = recorded(content)
        self._shown, self._camera = shown, -1
        for topic in [known for known in self._channels if known not in (*shown.topics, SCENE_TOPIC)]:
            self._channels.pop(topic).close()
        for topic, described in shown.topics.items():
            if topic not in self._channels:
                self._channels[topic] = Channel(
                    topic, schema=described.schema, message_encoding=described.message_encoding, context=self._context
                )
        if SCENE_TOPIC not in self._channels:
            self._channels[SCENE_TOPIC] = Channel(SCENE_TOPIC, message_encoding="json", context=self._context)
        for topic in self._channels:
            self._log_still(topic)

    def next_camera(self) -> None:
        """Show the next of the scene's cameras; after the last one the first."""
        if self._shown is not None and self._shown.cameras:
            self._camera = (self._camera + 1) % len(self._shown.cameras)
            self._log_still(_TRANSFORMS)
            self._log_camera()

    def attend(self, seconds: float) -> None:
        """For so long, send to whoever subscribes what does not move, and the camera of the moment."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            try:
                topic = self._subscribed.get(timeout=left)
            except queue.Empty:
                return
            self._log_still(topic)
            self._log_camera(topic)

    def _log_still(self, topic: str) -> None:
        if self._shown is None or topic not in self._channels:
            return
        at = self._clock()
        if topic == SCENE_TOPIC:
            self._channels[topic].log(json.dumps(self._shown.about).encode(), log_time=at)
        for message in self._shown.still.get(topic, ()):
            self._channels[topic].log(_at(message, at), log_time=at)

    def _log_camera(self, only: str = "") -> None:
        if self._shown is None or self._camera < 0:
            return
        at = self._clock()
        for topic, message in self._shown.cameras[self._camera]:
            if not only or topic == only:
                self._channels[topic].log(_at(message, at), log_time=at)


def follow(
    scene: LiveScene,
    shown: str,
    version: Callable[[], str],
    file: Callable[[str], bytes],
    stop: threading.Event,
    *,
    camera_s: float,
    poll_s: float,
) -> None:
    """Show each new version of a scene, and one camera after the other, until `stop` is set.

    A server that cannot be reached for a while is waited for; what is shown stays.

    Args:
        scene: where it is shown.
        shown: the version that it shows already.
        version: says which version is the current one.
        file: that version as MCAP.
        stop: set to end.
        camera_s: seconds between two cameras.
        poll_s: seconds between two looks for a new version.

    Raises:
        FastSplatError: what `version` and `file` raise, as for a scene that is gone.
    """
    look_in_s, camera_in_s = poll_s, 0.0
    while not stop.is_set():
        if look_in_s <= 0:
            look_in_s = poll_s
            try:
                current = version()
                if current != shown:
                    scene.show(file(current))
                    shown, camera_in_s = current, 0.0
            except FastSplatError as error:
                if not _may_pass(error):
                    raise
                _log.warning("version %s stays: %s", shown, error.message)
        if camera_in_s <= 0:
            camera_in_s = camera_s
            scene.next_camera()
        wait_s = min(camera_in_s, look_in_s, _MOST_WAIT_S)
        scene.attend(wait_s)
        look_in_s, camera_in_s = look_in_s - wait_s, camera_in_s - wait_s


def _may_pass(error: FastSplatError) -> bool:
    return error.kind in (Kind.UNAVAILABLE, Kind.DEADLINE_EXCEEDED) or error.retry_after_s is not None


class _Subscriptions(ServerListener):
    """Tells of every subscription."""

    def __init__(self, subscribed: Callable[[str], None]) -> None:
        self._subscribed = subscribed

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self._subscribed(channel.topic)


def _is_of_camera(transform: Any) -> bool:
    return bool(transform.child_frame_id == f"{transform.parent_frame_id}/camera")


def _at(message: Any, at: int) -> bytes:
    """The message as of this time; boxes replace all that there were before."""
    fields = message.DESCRIPTOR.fields_by_name
    if "timestamp" in fields:
        message.timestamp.FromNanoseconds(at)
    if "entities" in fields:
        for entity in message.entities:
            entity.timestamp.FromNanoseconds(at)
        del message.deletions[:]
        everything = message.deletions.add()
        everything.timestamp.FromNanoseconds(at)
        everything.type = type(everything).ALL
    return bytes(message.SerializeToString())
