"""MCAP files for Foxglove: named boxes, labelled points, cameras, photos, frames, floor map.

Written by foxglove-sdk, Foxglove's own writer with its own schemas.

Frames: the root is the version's world frame, named after the map that the scene is aligned to (`map` if unnamed), or
`world`. `ROOT/trained`, for aligned scenes, is the frame of training in this version's units. `ROOT/camera` is the
current camera, OpenCV axes.

Static content is logged at the version's creation time; the cameras follow in order, ten per second of the file, as a
scene has no clock.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from foxglove import Context, channels, messages, open_mcap
from foxglove.mcap import MCAPWriteOptions
from PIL import Image

from fastsplat.service.application.exporting.scene_recording import (
    SceneRecording,
    described,
    object_color,
    object_facts,
)
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.surfaces.occupancy import FREE, OCCUPIED, OccupancyMap
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.scene.formats.point_ply import point_rows
from fastsplat_contract.geometry.camera import Camera
from fastsplat_contract.geometry.poses import F64, Box, Quaternion, Vector3, quaternion_of, vector3
from fastsplat_contract.messages.objects import SceneObject

STEP_NS = 100_000_000
"""Time between two cameras."""

_GRID = np.dtype([("occupancy", "i1"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("alpha", "u1")])
_CELL_GRAYS = {FREE: 230, OCCUPIED: 20}
_TEXT_PIXELS = 14.0
_OBJECT_ALPHA, _SURFACE_ALPHA = 0.35, 0.1
_NUMERIC = {
    "i1": messages.PackedElementFieldNumericType.Int8,
    "u1": messages.PackedElementFieldNumericType.Uint8,
    "u2": messages.PackedElementFieldNumericType.Uint16,
    "f4": messages.PackedElementFieldNumericType.Float32,
}


def foxglove_file(index: SceneIndex, recording: SceneRecording, objects: Sequence[int] = ()) -> bytes:
    """A deterministic MCAP file of a scene, or of some objects.

    Topics: `/objects` (foxglove.SceneUpdate: an entity per object with a box, by id, with cube and text), `/points`
    (foxglove.PointCloud: the properties of `point_ply`, and alpha), `/cameras` (foxglove.PosesInFrame: all),
    `/camera/calibration`, `/camera/image`, `/tf`, and for scenes that have one `/map` (foxglove.Grid: `occupancy` as in
    nav_msgs/OccupancyGrid, and colors). Metadata: `scene`; `labels` and `objects`, names by id.
    """
    scene, buffer, context = index.scene, io.BytesIO(), Context()
    listed = [obj for obj in index.objects.listed if not objects or obj.id in objects]
    root, start = scene.frame_id, recording.created_ns
    # One thread, as scheduling of several may change the bytes.
    with open_mcap(buffer, context=context, writer_options=MCAPWriteOptions(compression_threads=0)) as writer:
        writer.write_metadata("scene", described(scene, recording, listed))
        writer.write_metadata("labels", {str(i): entry.label for i, entry in enumerate(scene.dictionary.entries, 1)})
        writer.write_metadata("objects", {str(obj.id): obj.name for obj in listed})
        channels.SceneUpdateChannel("/objects", context=context).log(
            _boxes(listed, scene.up(), root, start), log_time=start
        )
        channels.PointCloudChannel("/points", context=context).log(
            _cloud(recording.points, root, start), log_time=start
        )
        poses = [_pose(*_motion(posed.world_from_camera)) for posed in scene.cameras]
        message = messages.PosesInFrame(timestamp=_time(start), frame_id=root, poses=poses)
        channels.PosesInFrameChannel("/cameras", context=context).log(message, log_time=start)
        if recording.floor is not None:
            channels.GridChannel("/map", context=context).log(_grid(recording.floor, root, start), log_time=start)
        _log_frames(scene, recording, root, context)
    return buffer.getvalue()


def _log_frames(scene: Scene, recording: SceneRecording, root: str, context: Context) -> None:
    """Logs the trained frame, then each camera with intrinsics and photo at its time."""
    start, frame = recording.created_ns, f"{root}/camera"
    tf = channels.FrameTransformChannel("/tf", context=context)
    calibration = channels.CameraCalibrationChannel("/camera/calibration", context=context)
    image = channels.CompressedImageChannel("/camera/image", context=context)
    if scene.alignment is not None:
        rotation = quaternion_of(np.array(scene.alignment.rotation))
        tf.log(
            _transform(root, f"{root}/trained", Vector3(*scene.alignment.translation), rotation, start), log_time=start
        )
    for number, posed in enumerate(scene.cameras):
        at, photo, camera = start + number * STEP_NS, recording.photos.get(number), posed.camera
        tf.log(_transform(root, frame, *_motion(posed.world_from_camera), at), log_time=at)
        if photo is not None:
            with Image.open(io.BytesIO(photo)) as opened:
                camera = camera.scaled_to(*opened.size)
            image.log(
                messages.CompressedImage(timestamp=_time(at), frame_id=frame, data=photo, format="jpeg"), log_time=at
            )
        calibration.log(_calibration(camera, frame, at), log_time=at)


def _boxes(listed: Sequence[SceneObject], up: F64 | None, root: str, at: int) -> messages.SceneUpdate:
    return messages.SceneUpdate(
        entities=[
            messages.SceneEntity(
                timestamp=_time(at),
                frame_id=root,
                id=str(obj.id),
                metadata=[messages.KeyValuePair(key=key, value=value) for key, value in object_facts(obj).items()],
                cubes=[
                    messages.CubePrimitive(
                        pose=_pose(obj.box.center.position, obj.box.center.orientation),
                        size=_vector(obj.box.size),
                        color=_color(obj.id, _SURFACE_ALPHA if obj.kind == "surface" else _OBJECT_ALPHA),
                    )
                ],
                texts=[_text(obj, obj.box, up)],
            )
            for obj in listed
            if obj.box is not None
        ]
    )


def _text(obj: SceneObject, box: Box, up: F64 | None) -> messages.TextPrimitive:
    """Name above the box, or in its center if up is unknown."""
    place = np.array(box.center.position)
    if up is not None:
        axes = box.center.matrix()[:3, :3]
        place = place + up * float(np.abs(axes.T @ up) @ np.array(box.size)) / 2
    return messages.TextPrimitive(
        pose=_pose(vector3(place), Quaternion(0.0, 0.0, 0.0, 1.0)),
        billboard=True,
        font_size=_TEXT_PIXELS,
        scale_invariant=True,
        color=_color(obj.id, 1.0),
        text=obj.name or f"object {obj.id}",
    )


def _color(object_id: int, alpha: float) -> messages.Color:
    red, green, blue = object_color(object_id)
    return messages.Color(r=red, g=green, b=blue, a=alpha)


def _cloud(points: bytes, root: str, at: int) -> messages.PointCloud:
    rows = point_rows(points)
    # Foxglove requires all four color fields.
    packed = np.empty(len(rows), np.dtype([*rows.dtype.descr, ("alpha", "u1")]))
    for name in rows.dtype.names or ():
        packed[name] = rows[name]
    packed["alpha"] = 255
    return messages.PointCloud(
        timestamp=_time(at),
        frame_id=root,
        pose=_pose(Vector3(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0)),
        point_stride=packed.dtype.itemsize,
        fields=_fields(packed.dtype),
        data=packed.tobytes(),
    )


def _grid(floor: OccupancyMap, root: str, at: int) -> messages.Grid:
    """Grid at the floor's height; unknown cells are transparent."""
    packed = np.zeros(floor.cells.shape, _GRID)
    packed["occupancy"] = floor.cells
    for value, gray in _CELL_GRAYS.items():
        for channel in ("red", "green", "blue"):
            packed[channel][floor.cells == value] = gray
        packed["alpha"][floor.cells == value] = 255
    width = floor.cells.shape[1]
    return messages.Grid(
        timestamp=_time(at),
        frame_id=root,
        pose=_pose(Vector3(*floor.origin, floor.floor), Quaternion(0.0, 0.0, 0.0, 1.0)),
        column_count=width,
        cell_size=messages.Vector2(x=floor.resolution, y=floor.resolution),
        row_stride=width * _GRID.itemsize,
        cell_stride=_GRID.itemsize,
        fields=_fields(_GRID),
        data=packed.tobytes(),
    )


def _fields(rows: np.dtype[Any]) -> list[messages.PackedElementField]:
    return [
        messages.PackedElementField(name=name, offset=offset, type=_NUMERIC[kind.str[1:]])
        for name, (kind, offset, *_) in (rows.fields or {}).items()
    ]


def _calibration(camera: Camera, frame: str, at: int) -> messages.CameraCalibration:
    """Pixels as in OpenCV and ROS: the center of the top-left one is (0, 0)."""
    cx, cy = camera.cx - 0.5, camera.cy - 0.5
    return messages.CameraCalibration(
        timestamp=_time(at),
        frame_id=frame,
        width=camera.width,
        height=camera.height,
        distortion_model="plumb_bob",
        D=[0.0] * 5,
        K=[camera.fx, 0.0, cx, 0.0, camera.fy, cy, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[camera.fx, 0.0, cx, 0.0, 0.0, camera.fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def _transform(parent: str, child: str, translation: Vector3, rotation: Quaternion, at: int) -> messages.FrameTransform:
    return messages.FrameTransform(
        timestamp=_time(at),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=_vector(translation),
        rotation=_quaternion(rotation),
    )


def _motion(pose: F64) -> tuple[Vector3, Quaternion]:
    return vector3(pose[:3, 3]), quaternion_of(pose[:3, :3])


def _pose(position: Vector3, orientation: Quaternion) -> messages.Pose:
    return messages.Pose(position=_vector(position), orientation=_quaternion(orientation))


def _vector(vector: Vector3) -> messages.Vector3:
    return messages.Vector3(**vector._asdict())


def _quaternion(rotation: Quaternion) -> messages.Quaternion:
    return messages.Quaternion(**rotation._asdict())


def _time(at: int) -> messages.Timestamp:
    return messages.Timestamp(*divmod(at, 10**9))
