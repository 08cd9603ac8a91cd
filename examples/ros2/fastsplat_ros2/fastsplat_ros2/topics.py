"""Which topic shows what of a scene: the same for the node and for a bag."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from fastsplat_ros2 import messages
from fastsplat_ros2.messages import MessageMaker
from fastsplat_ros2.snapshot import Snapshot

TOPICS = {
    "/fastsplat/detections": "vision_msgs/msg/Detection3DArray",
    "/fastsplat/points": "sensor_msgs/msg/PointCloud2",
    "/map": "nav_msgs/msg/OccupancyGrid",
}
"""Types of the topics; all are kept for who subscribes later (transient local)."""


class Published(NamedTuple):
    """One message and where it goes."""

    topic: str
    message: Any


def published(make: MessageMaker, snapshot: Snapshot) -> Iterator[Published]:
    """All messages of `TOPICS` that a scene has: a map only where it has one."""
    frame_id, stamp_ns = snapshot.detections.frame_id, snapshot.stamp_ns
    yield Published("/fastsplat/detections", messages.detection_array(make, snapshot.detections, stamp_ns))
    yield Published("/fastsplat/points", messages.point_cloud(make, snapshot.points, frame_id, stamp_ns))
    if snapshot.floor_map is not None:
        yield Published("/map", messages.occupancy_grid(make, snapshot.floor_map, frame_id, stamp_ns))
