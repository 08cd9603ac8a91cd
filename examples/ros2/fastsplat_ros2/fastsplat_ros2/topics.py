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


def published(make: MessageMaker, shown: Snapshot) -> Iterator[Published]:
    """All messages of `TOPICS` that a scene has: a map only where it has one."""
    frame_id, stamp_ns = shown.detections.frame_id, shown.stamp_ns
    yield Published("/fastsplat/detections", messages.detection_array(make, shown.detections, stamp_ns))
    yield Published("/fastsplat/points", messages.point_cloud(make, shown.points, frame_id, stamp_ns))
    if shown.floor_map is not None:
        yield Published("/map", messages.occupancy_grid(make, shown.floor_map, frame_id, stamp_ns))
