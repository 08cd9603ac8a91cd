"""Messages of ROS 2 made of what the client returns. Pure: who makes messages (rclpy, rosbags) is an argument.

Frames are right-handed, lengths meters, angles radians (REP 103): a scene without a known scale is refused. Frame ids
are those of the scene: the map's name that it was aligned to, else `world`.
"""

from __future__ import annotations

import io
import math
import re
import zipfile
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import yaml
from numpy.typing import NDArray

from fastsplat_client import Answer, Detection, DetectionList, InvalidInputError, Pose, Quaternion, Scene, Vector3

UNKNOWN_ROTATION = math.pi**2 / 3
"""Variance of an angle of which nothing is known, radians squared: uniform over a whole turn."""

TRAINED_FRAME = "scene"
"""The frame of the scene as it was trained, below the map that it was aligned to."""

_FLOAT32, _UINT16 = 7, 4  # of sensor_msgs/PointField
_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4"), ("label", "<u2"), ("object", "<u2")])
_PLY_TYPES = {"float": "<f4", "uchar": "u1", "ushort": "<u2"}


class MessageMaker(Protocol):
    """Makes messages and their arrays, as one library of ROS has them."""

    def message(self, name: str, /, **fields: Any) -> Any:
        """A message, e.g. of "geometry_msgs/msg/Point", with all of its fields."""
        ...

    def array(self, values: NDArray[Any]) -> Any:
        """The value of a field that is an array of numbers."""
        ...


def detection_array(make: MessageMaker, page: DetectionList, stamp_ns: int) -> Any:
    """vision_msgs/Detection3DArray of all objects that have a box.

    A detection's id is the object's. Its results are its label and then the other names that it may have, each with
    its probability; an object of which nothing has a name has none. All of them have the box's pose, with the
    covariance; where the orientation is not known its variances are `UNKNOWN_ROTATION`. Its stamp is the time at
    which a photo last showed it, where that is known.

    Args:
        make: see `MessageMaker`.
        page: the objects, of all pages.
        stamp_ns: of the message, nanoseconds since 1970.

    Raises:
        InvalidInputError: the scene is not in meters.
    """
    check_meters(page.meters)
    boxed = [detection for detection in page.detections if detection.box is not None]
    return make.message(
        "vision_msgs/msg/Detection3DArray",
        header=_header(make, page.frame_id, stamp_ns),
        detections=[_detection(make, detection, page.frame_id, stamp_ns) for detection in boxed],
    )


def found(page: DetectionList, answer: Answer) -> DetectionList:
    """The objects that answer a question, the best first; parts of objects are not among them."""
    by_id = {detection.object_id: detection for detection in page.detections}
    return page._replace(detections=tuple(by_id[number] for number in answer.object_ids if number in by_id))


def point_cloud(make: MessageMaker, ply: bytes, frame_id: str, stamp_ns: int) -> Any:
    """sensor_msgs/PointCloud2 of the export `points`: x y z rgb label object; label and object are ids, 0 for none.

    Args:
        make: see `MessageMaker`.
        ply: the file.
        frame_id: of its points.
        stamp_ns: of the message, nanoseconds since 1970.
    """
    rows = ply_rows(ply)
    points = np.empty(len(rows), _POINT)
    for name in ("x", "y", "z", "label", "object"):
        points[name] = rows[name]
    red, green, blue = (rows[name].astype(np.uint32) for name in ("red", "green", "blue"))
    points["rgb"] = red << 16 | green << 8 | blue  # packed, as PCL and RViz read it
    assert _POINT.fields is not None
    fields = [
        make.message(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=offset,
            datatype=_UINT16 if name in ("label", "object") else _FLOAT32,
            count=1,
        )
        for name, (_, offset, *_) in _POINT.fields.items()
    ]
    return make.message(
        "sensor_msgs/msg/PointCloud2",
        header=_header(make, frame_id, stamp_ns),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=_POINT.itemsize,
        row_step=points.nbytes,
        data=make.array(np.frombuffer(points.tobytes(), np.uint8)),
        is_dense=True,
    )


def occupancy_grid(make: MessageMaker, archive: bytes, frame_id: str, stamp_ns: int) -> Any:
    """nav_msgs/OccupancyGrid of the export `map`: 0 free, 100 occupied, -1 unknown, as nav2's map_server reads it.

    Args:
        make: see `MessageMaker`.
        archive: the zip of `map.yaml` and its picture.
        frame_id: of the map.
        stamp_ns: of the message, nanoseconds since 1970.
    """
    with zipfile.ZipFile(io.BytesIO(archive)) as files:
        facts = yaml.safe_load(files.read("map.yaml"))
        pixels = pgm_pixels(files.read(facts["image"]))
    share = (pixels.astype(np.float64) if facts["negate"] else 255 - pixels.astype(np.float64)) / 255
    cells = np.full(pixels.shape, -1, np.int8)
    cells[share > facts["occupied_thresh"]] = 100
    cells[share < facts["free_thresh"]] = 0
    x, y, yaw = (float(value) for value in facts["origin"])
    origin = Pose(Vector3(x, y, 0.0), Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)))
    height, width = pixels.shape
    return make.message(
        "nav_msgs/msg/OccupancyGrid",
        header=_header(make, frame_id, stamp_ns),
        info=make.message(
            "nav_msgs/msg/MapMetaData",
            map_load_time=_time(make, stamp_ns),
            resolution=float(facts["resolution"]),
            width=width,
            height=height,
            origin=_pose(make, origin),
        ),
        data=make.array(np.ascontiguousarray(cells[::-1]).ravel()),  # its first row is at the least y
    )


def map_transform(make: MessageMaker, scene: Scene, frame_id: str, stamp_ns: int) -> Any | None:
    """geometry_msgs/TransformStamped from the map to the scene as it was trained (in meters); None for a scene that
    was put into no map: where it lies in one, nobody knows then.

    Args:
        make: see `MessageMaker`.
        scene: see `Client.scene`.
        frame_id: the map's, see `DetectionList`.
        stamp_ns: of the message, nanoseconds since 1970.
    """
    if scene.alignment is None:
        return None
    pose = scene.alignment.transform
    return make.message(
        "geometry_msgs/msg/TransformStamped",
        header=_header(make, frame_id, stamp_ns),
        child_frame_id=TRAINED_FRAME if frame_id != TRAINED_FRAME else f"{TRAINED_FRAME}/trained",
        transform=make.message(
            "geometry_msgs/msg/Transform",
            translation=_vector(make, pose.position),
            rotation=_quaternion(make, pose.orientation),
        ),
    )


def check_meters(meters: bool) -> None:
    """Refuse a scene whose unit nobody knows.

    Raises:
        InvalidInputError: it is not in meters.
    """
    if not meters:
        raise InvalidInputError(
            "ROS needs meters, and this scene's unit is arbitrary",
            field="scene",
            hint="Scale the scene by a known length (client.scale_scene), or upload with poses in meters.",
        )


def whole(pages: Iterable[DetectionList]) -> DetectionList:
    """All pages of one list as one."""
    first, *rest = pages
    everything = (*first.detections, *(detection for page in rest for detection in page.detections))
    return first._replace(detections=everything, next_page_token="")


def ply_rows(content: bytes) -> NDArray[Any]:
    """The vertices of a binary little-endian PLY of numbers, with its properties as fields."""
    head, _, body = content.partition(b"end_header\n")
    (count,) = re.findall(rb"^element vertex (\d+)$", head, re.MULTILINE)
    properties = re.findall(r"^property (\w+) (\w+)$", head.decode("ascii"), re.MULTILINE)
    return np.frombuffer(body, np.dtype([(name, _PLY_TYPES[kind]) for kind, name in properties]), int(count))


def pgm_pixels(content: bytes) -> NDArray[np.uint8]:
    """uint8 [H, W] of a binary PGM of 8 bits, its first row at the top.

    Raises:
        InvalidInputError: it is none.
    """
    header = re.match(rb"P5\s(?:\s*#[^\n]*\n)*\s*(\d+)\s+(\d+)\s+255\s", content)
    if header is None:
        raise InvalidInputError("the map's picture is no binary PGM of 8 bits", field="map")
    width, height = int(header[1]), int(header[2])
    return np.frombuffer(content, np.uint8, width * height, header.end()).reshape(height, width)


def _detection(make: MessageMaker, detection: Detection, frame_id: str, stamp_ns: int) -> Any:
    assert detection.box is not None
    names = [(name, probability) for name, probability, *_ in detection.alternatives]
    if detection.label and detection.probability is not None:
        names.insert(0, (detection.label, detection.probability))
    seen_ns = stamp_ns if detection.last_seen is None else round(detection.last_seen.timestamp() * 1e6) * 1000
    pose = _pose(make, detection.box.center)
    covariance = make.array(pose_covariance(detection).ravel())
    return make.message(
        "vision_msgs/msg/Detection3D",
        header=_header(make, frame_id, seen_ns),
        results=[
            make.message(
                "vision_msgs/msg/ObjectHypothesisWithPose",
                hypothesis=make.message("vision_msgs/msg/ObjectHypothesis", class_id=name, score=float(score)),
                pose=make.message("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance),
            )
            for name, score in names
        ],
        bbox=make.message("vision_msgs/msg/BoundingBox3D", center=pose, size=_vector(make, detection.box.size)),
        id=str(detection.object_id),
    )


def pose_covariance(detection: Detection) -> NDArray[np.float64]:
    """float64 [6, 6] of x y z and rotations about x y z: `Detection.covariance`, with `UNKNOWN_ROTATION` for what is
    not known of the orientation; every object with a box has one of its position."""
    if detection.rotation_covariance:
        return detection.covariance()
    unknown = tuple((UNKNOWN_ROTATION * np.eye(3)).ravel().tolist())
    return replace(detection, rotation_covariance=unknown).covariance()


def _time(make: MessageMaker, stamp_ns: int) -> Any:
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return make.message("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)


def _header(make: MessageMaker, frame_id: str, stamp_ns: int) -> Any:
    return make.message("std_msgs/msg/Header", stamp=_time(make, stamp_ns), frame_id=frame_id)


def _pose(make: MessageMaker, pose: Pose) -> Any:
    position = make.message("geometry_msgs/msg/Point", **pose.position._asdict())
    orientation = _quaternion(make, pose.orientation)
    return make.message("geometry_msgs/msg/Pose", position=position, orientation=orientation)


def _vector(make: MessageMaker, vector: Vector3) -> Any:
    return make.message("geometry_msgs/msg/Vector3", **vector._asdict())


def _quaternion(make: MessageMaker, quaternion: Quaternion) -> Any:
    return make.message("geometry_msgs/msg/Quaternion", **quaternion._asdict())
