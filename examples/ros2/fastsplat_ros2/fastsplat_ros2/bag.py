"""A scene as a ROS 2 bag, without ROS: `python -m fastsplat_ros2.bag SCENE OUT`; needs rosbags from PyPI."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fastsplat_client import Client, FastSplatError
from fastsplat_ros2 import messages
from fastsplat_ros2.snapshot import Snapshot, read_snapshot
from fastsplat_ros2.topics import TOPICS, published

_VISION = {
    "ObjectHypothesis": "string class_id\nfloat64 score\n",
    "ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n",
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "Detection3D": "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nstring id\n",
    "Detection3DArray": "std_msgs/Header header\nDetection3D[] detections\n",
}
"""The fields of vision_msgs 4, which rosbags does not bring."""

_FOREVER = QosTime(2147483647, 4294967295)
_LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _FOREVER,
    _FOREVER,
    QosLiveliness.AUTOMATIC,
    _FOREVER,
    False,
)
_TRANSFORMS = "tf2_msgs/msg/TFMessage"


def types_with_vision() -> Typestore:
    """The types of ROS 2 Jazzy and those of vision_msgs."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = {}
    for name, fields in _VISION.items():
        types.update(get_types_from_msg(fields, f"vision_msgs/msg/{name}"))
    store.register(types)
    return store


class BagMessages:
    """`MessageMaker` of rosbags."""

    def __init__(self, store: Typestore) -> None:
        self._store = store

    def message(self, name: str, /, **fields: Any) -> Any:
        """A message of a type that the store knows."""
        return self._store.types[name](**fields)

    def array(self, values: NDArray[Any]) -> NDArray[Any]:
        """As it is."""
        return np.asarray(values)


def write_bag(snapshot: Snapshot, folder: Path) -> list[str]:
    """Write a new bag (MCAP) of a scene; returns its topics. All messages have the time at which the version was made.

    Args:
        snapshot: of the scene.
        folder: of the bag, which is not there yet.

    Raises:
        InvalidInputError: the scene is not in meters.
        WriterError: the folder is there.
    """
    store = types_with_vision()
    make = BagMessages(store)
    sent = [(topic, TOPICS[topic], message) for topic, message in published(make, snapshot)]
    transform = messages.map_transform(make, snapshot.scene, snapshot.detections.frame_id, snapshot.stamp_ns)
    if transform is not None:
        sent.append(("/tf_static", _TRANSFORMS, make.message(_TRANSFORMS, transforms=[transform])))
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        for topic, kind, message in sent:
            connection = bag.add_connection(topic, kind, typestore=store, offered_qos_profiles=[_LATCHED])
            bag.write(connection, snapshot.stamp_ns, store.serialize_cdr(message, kind))
    return [topic for topic, _, _ in sent]


def main(arguments: list[str] | None = None) -> int:
    """The command; 0 if the bag is written."""
    parser = argparse.ArgumentParser("fastsplat_ros2.bag", description="Write a scene as a ROS 2 bag.")
    parser.add_argument("scene", help="id of the scene")
    parser.add_argument("out", type=Path, help="folder of the bag, which is not there yet")
    parser.add_argument("--server", default="http://127.0.0.1:8000", help="its key comes from FASTSPLAT_KEY")
    options = parser.parse_args(arguments)
    try:
        with Client(options.server, key=os.environ.get("FASTSPLAT_KEY", "")) as client:
            snapshot = read_snapshot(client, options.scene)
    except FastSplatError as error:
        print(f"{error.reason}: {error.message}. {error.hint}", file=sys.stderr)
        return 1
    if options.out.exists():
        print(f"{options.out} is there already", file=sys.stderr)
        return 1
    print("\n".join(write_bag(snapshot, options.out)))
    if snapshot.no_map:
        print(f"without a map: {snapshot.no_map}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
