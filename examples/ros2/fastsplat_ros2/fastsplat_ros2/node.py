"""The ROS 2 node: the only module that needs rclpy. It reads, converts and sends; nothing is decided here."""

from __future__ import annotations

import array
import os
from typing import Any

import numpy as np
import rclpy
from fastsplat_interfaces.srv import Find
from numpy.typing import NDArray
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosidl_runtime_py.utilities import get_message
from tf2_ros import StaticTransformBroadcaster

from fastsplat_client import Client, FastSplatError
from fastsplat_ros2 import messages
from fastsplat_ros2.snapshot import Snapshot, read_snapshot
from fastsplat_ros2.topics import TOPICS, published


class RosMessages:
    """`MessageMaker` of rclpy."""

    def message(self, name: str, /, **fields: Any) -> Any:
        """A message of an installed package."""
        return get_message(name)(**fields)

    def array(self, values: NDArray[Any]) -> Any:
        """Bounded arrays take numpy's, sequences of bytes Python's own."""
        return values if values.dtype == np.float64 else array.array(values.dtype.char, values.tobytes())


class SceneNode(Node):  # type: ignore[misc]  # rclpy has no types
    """Shows one scene: `TOPICS`, /tf_static and the service `find`. Parameters: `server`, `scene`, `period`; the key
    comes from FASTSPLAT_KEY."""

    def __init__(self) -> None:
        super().__init__("fastsplat")
        for name, value in (("server", "http://127.0.0.1:8000"), ("scene", ""), ("period", 5.0)):
            self.declare_parameter(name, value)
        self._scene_id: str = self.get_parameter("scene").value
        self._client = Client(self.get_parameter("server").value, key=os.environ.get("FASTSPLAT_KEY", ""))
        self._published: Snapshot | None = None
        self._make = RosMessages()
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._publishers_of = {
            topic: self.create_publisher(get_message(kind), topic, latched) for topic, kind in TOPICS.items()
        }
        self._transforms = StaticTransformBroadcaster(self)
        self.create_service(Find, "find", self.find)
        self.create_timer(float(self.get_parameter("period").value), self.refresh)
        self.refresh()

    def refresh(self) -> None:
        """Publish the scene's current version, if it is not the one that is shown."""
        try:
            if self._published and self._client.scene(self._scene_id).version == self._published.scene.version:
                return
            snapshot = read_snapshot(self._client, self._scene_id)
        except FastSplatError as error:
            self.get_logger().error(f"{error.reason}: {error.message}. {error.hint}")
            return
        for topic, message in published(self._make, snapshot):
            self._publishers_of[topic].publish(message)
        transform = messages.map_transform(self._make, snapshot.scene, snapshot.detections.frame_id, snapshot.stamp_ns)
        if transform is not None:
            self._transforms.sendTransform(transform)
        if snapshot.no_map:
            self.get_logger().warning(f"no map is published: {snapshot.no_map}")
        self._published = snapshot

    def find(self, request: Any, response: Any) -> Any:
        """Answer a question about the version that is shown."""
        response.success, response.probability = False, float("nan")
        if self._published is None:
            response.message = "no scene is shown yet; the log says why"
            return response
        try:
            version = self._published.scene.version
            (answer,) = self._client.query(self._scene_id, request.text, outputs=["objects"], version=version)
        except FastSplatError as error:
            response.message = f"{error.reason}: {error.message}. {error.hint}"
            return response
        response.success, response.message, response.outcome = True, answer.sentence, answer.outcome
        response.version = answer.version
        if answer.probability is not None:
            response.probability = answer.probability
        page = messages.found(self._published.detections, answer)
        response.detections = messages.detection_array(self._make, page, self._published.stamp_ns)
        return response


def main() -> None:
    """Run the node until it is stopped."""
    rclpy.init()
    node = SceneNode()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
