"""MCAP files for Foxglove, as the format's own reader and protobuf decoder read them."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from google.protobuf.message import Message
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image
from plyfile import PlyData
from scipy.spatial.transform import Rotation

from fastsplat.service.application.exporting.foxglove_file import STEP_NS, foxglove_file
from fastsplat.service.application.exporting.geometry_files import points_file
from fastsplat.service.application.exporting.scene_recording import SceneRecording, bounded_photos
from fastsplat.service.query.edits.aligning import align_scene
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.surfaces.occupancy import FREE, OCCUPIED, UNKNOWN, OccupancyMap
from fastsplat.service.scene.artefact.frames import frame_of, scaled
from fastsplat.service.scene.artefact.scaling import ScaledLength, combined
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.places import Alignment
from fastsplat_contract.geometry.poses import Pose, Vector3, quaternion_of
from fastsplat_contract.messages.scenes import Edit
from tests.capture.upload_files import encoded
from tests.query.wall import wall_index

_NUMPY = {1: "u1", 3: "<u2", 7: "<f4"}


START = 1_700_000_000_250_000_000  # nanoseconds since 1970 at which the recording begins
PHOTOS = {  # JPEG files by the number of their camera
    number: encoded(Image.new("RGB", (32, 24), color), "JPEG")
    for number, color in ((0, (200, 10, 10)), (2, (10, 10, 200)))
}


@pytest.fixture(scope="module")
def index() -> SceneIndex:
    """The wall, seen by three cameras that differ in pose and lens."""
    cameras = []
    for number, angle in enumerate((-0.1, 0.0, 0.15)):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("xyz", [angle / 2, angle, angle / 3]).as_matrix()
        pose[:3, 3] = 2 * angle, -angle, 0.1
        cameras.append(PosedCamera(Camera(64, 48 + number, 60.0 + number, 61.0, 31.0, 25.0), pose, f"{number}.png"))
    return wall_index(cameras=cameras)


def _written(index: SceneIndex, objects: Sequence[int] = ()) -> bytes:
    points = points_file(index, "wall", objects, 0.05)
    return foxglove_file(index, SceneRecording("an-id", "v7", "wall", START, points, PHOTOS, 1), objects)


def _messages(content: bytes) -> dict[str, list[tuple[int, Any]]]:
    """Time and message of each, by topic."""
    read: dict[str, list[tuple[int, Any]]] = {}
    reader = make_reader(io.BytesIO(content), validate_crcs=True, decoder_factories=[DecoderFactory()])
    for schema, channel, message, decoded in reader.iter_decoded_messages():
        assert schema is not None and schema.name == f"foxglove.{decoded.DESCRIPTOR.name}"
        assert message.log_time == message.publish_time
        read.setdefault(channel.topic, []).append((message.log_time, decoded))
    return read


def _metadata(content: bytes) -> dict[str, Mapping[str, str]]:
    return {record.name: record.metadata for record in make_reader(io.BytesIO(content)).iter_metadata()}


def _numbers(message: Message) -> list[float]:
    return [getattr(message, name) for name in ("x", "y", "z", "w") if hasattr(message, name)]


def _matrix(translation: Message, rotation: Message) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(_numbers(rotation)).as_matrix()
    matrix[:3, 3] = _numbers(translation)
    return matrix


def test_each_object_is_a_box_with_its_name(index: SceneIndex) -> None:
    ((at, update),) = _messages(_written(index))["/objects"]
    assert at == START and len(update.entities) == len(index.objects.listed) == 2
    for entity, obj in zip(update.entities, index.objects.listed, strict=True):
        assert (entity.id, entity.frame_id, obj.box is None) == (str(obj.id), "world", False)
        (cube,), (text,) = entity.cubes, entity.texts
        assert obj.box is not None
        assert _numbers(cube.pose.position) == list(obj.box.center.position)
        assert _numbers(cube.pose.orientation) == list(obj.box.center.orientation)
        assert _numbers(cube.size) == list(obj.box.size)
        assert 0 < cube.color.a < text.color.a == 1
        assert text.text == obj.name
        facts = {pair.key: pair.value for pair in entity.metadata}
        assert (facts["name"], float(facts["probability"])) == (obj.name, obj.probability)
        assert int(facts["gaussians"]) == obj.gaussian_count
    (_, only), *_ = _messages(_written(index, (2,)))["/objects"]
    assert [entity.id for entity in only.entities] == ["2"]


@pytest.mark.parametrize("objects", [(), (2,)])
def test_the_cloud_is_that_of_the_points_file(index: SceneIndex, objects: tuple[int, ...]) -> None:
    ((_, cloud),) = _messages(_written(index, objects))["/points"]
    fields = {field.name: (_NUMPY[field.type], field.offset) for field in cloud.fields}
    rows = np.frombuffer(
        cloud.data,
        np.dtype(
            {
                "names": list(fields),
                "formats": [kind for kind, _ in fields.values()],
                "offsets": [offset for _, offset in fields.values()],
                "itemsize": cloud.point_stride,
            }
        ),
    )
    vertices = PlyData.read(io.BytesIO(points_file(index, "wall", objects, 0.05)))["vertex"]
    assert len(rows) == vertices.count > 100
    for prop in vertices.properties:
        np.testing.assert_array_equal(rows[prop.name], vertices[prop.name])
    assert (rows["alpha"] == 255).all() and {"label", "object"} <= set(fields)
    assert set(rows["object"].tolist()) == set(objects or (1, 2))


def test_the_map_of_the_floor_is_a_grid_at_its_height(index: SceneIndex) -> None:
    cells = np.array([[FREE, OCCUPIED, UNKNOWN], [UNKNOWN, FREE, FREE]], np.int8)
    floor = OccupancyMap(cells, np.zeros((2, 3), np.float32), 0.05, (-1.5, 2.0), 0.12, "surface", "", 1.5)
    recording = SceneRecording("an-id", "v7", "wall", START, points_file(index, "wall", (), 0.05), {}, floor=floor)
    ((at, grid),) = _messages(foxglove_file(index, recording))["/map"]
    assert (at, grid.frame_id, grid.column_count) == (START, "world", 3)
    assert _numbers(grid.pose.position) == [-1.5, 2.0, 0.12] and (grid.cell_size.x, grid.cell_size.y) == (0.05, 0.05)
    offsets = {field.name: field.offset for field in grid.fields}
    assert {field.name: field.type for field in grid.fields}["occupancy"] == 2  # signed, as in nav_msgs/OccupancyGrid
    for (row, column), value in np.ndenumerate(cells):  # rows lie along +y, columns along +x, as the cells do
        cell = grid.data[row * grid.row_stride + column * grid.cell_stride :]
        assert np.frombuffer(cell[offsets["occupancy"] :][:1], np.int8)[0] == value
        assert (cell[offsets["alpha"]] == 0) == (value == UNKNOWN)
        assert (cell[offsets["red"]] > 128) == (value == FREE)
    assert "/map" not in _messages(_written(index))


def test_cameras_follow_one_another_with_their_photos(index: SceneIndex) -> None:
    read = _messages(_written(index))
    assert [at for at, _ in read["/camera/calibration"]] == [START + number * STEP_NS for number in range(3)]
    for number, posed in enumerate(index.scene.cameras):
        at, transform = read["/tf"][number]
        later, lens = read["/camera/calibration"][number]
        assert at == later == transform.timestamp.ToNanoseconds()
        assert (transform.parent_frame_id, transform.child_frame_id) == ("world", lens.frame_id)
        np.testing.assert_allclose(
            _matrix(transform.translation, transform.rotation), posed.world_from_camera, atol=1e-12
        )
        point = posed.world_from_camera @ [0.2, -0.1, 2.0, 1.0]  # as the reader projects it, and as the scene does
        seen = np.linalg.inv(_matrix(transform.translation, transform.rotation)) @ point
        u, v, w = np.array(lens.P).reshape(3, 4) @ seen
        camera = posed.camera.scaled_to(lens.width, lens.height)
        pixel = camera.fx * 0.1 + camera.cx, camera.fy * -0.05 + camera.cy
        assert (u / w + 0.5, v / w + 0.5) == pytest.approx(pixel)  # there the middle of the first pixel is 0, here 0.5
        assert (lens.width, lens.height) == ((32, 24) if number in PHOTOS else (64, 48 + number))
    assert [(at, image.data) for at, image in read["/camera/image"]] == [
        (START + number * STEP_NS, photo) for number, photo in PHOTOS.items()
    ]
    ((_, poses),) = read["/cameras"]
    for pose, posed in zip(poses.poses, index.scene.cameras, strict=True):
        np.testing.assert_allclose(_matrix(pose.position, pose.orientation), posed.world_from_camera, atol=1e-12)


def test_frames_of_a_map_lead_back_to_the_trained_scene(index: SceneIndex) -> None:
    length = ScaledLength(units=2.0, deviation=0.01, meters=1.0, meters_deviation=0.002)
    trained = dataclasses.replace(index.scene, scale="ARBITRARY")
    metric = index.after(scaled(trained, combined([length])))
    turn = quaternion_of(Rotation.from_euler("xyz", [0.3, -1.1, 2.0]).as_matrix())
    aligned = align_scene(metric, Edit("align", alignment=Alignment("hall 3", Pose(Vector3(4.0, -2.0, 1.5), turn))))
    moved = index.after(aligned)
    content = _written(moved)
    read = _messages(content)
    transform = next(transform for _, transform in read["/tf"] if transform.child_frame_id == "hall 3/trained")
    assert transform.parent_frame_id == "hall 3"
    up = np.pad(0.5 * trained.gaussians.means, ((0, 0), (0, 1)), constant_values=1)  # units of this version
    there = (up @ _matrix(transform.translation, transform.rotation).T)[:, :3]
    np.testing.assert_allclose(there, aligned.gaussians.means, atol=1e-5)
    np.testing.assert_allclose(there, frame_of(aligned).points(trained.gaussians.means), atol=1e-6)
    names = {entity.frame_id for entity in read["/objects"][0][1].entities} | {read["/points"][0][1].frame_id}
    assert names == {"hall 3"} == {transform.parent_frame_id for _, transform in read["/tf"]}
    about = _metadata(content)["scene"]
    low, high = json.loads(about["meters_per_unit_95"])
    assert low < float(about["meters_per_unit"]) == 0.5 < high and about["unit"] == "metre" and "warning" not in about


def test_metadata_says_what_the_scene_is_and_that_lengths_are_not_meters(index: SceneIndex) -> None:
    content = _written(index.after(dataclasses.replace(index.scene, scale="ARBITRARY")))
    read = _metadata(content)
    about = read["scene"]
    assert (about["scene_id"], about["version"], about["name"]) == ("an-id", "v7", "wall")
    assert (about["scale"], about["unit"]) == ("ARBITRARY", "arbitrary") and "not meters" in about["warning"]
    assert not any(key.startswith("meters") for key in about)
    assert (about["photos"], about["photos_left_out"], about["cameras"], about["objects"]) == ("2", "1", "3", "2")
    assert read["labels"] == {"1": "red half", "2": "grün\nhalf"} == read["objects"]
    assert _metadata(_written(index, (2,)))["objects"] == {"2": "grün\nhalf"}


def test_the_same_version_is_the_same_bytes(index: SceneIndex) -> None:
    assert _written(index) == _written(index.after(dataclasses.replace(index.scene))) == _written(index)
    assert _written(index) != _written(index, (1,))


def test_photos_are_bounded_evenly() -> None:
    sizes = dict.fromkeys(range(10), 10)
    assert bounded_photos(sizes, 100) == list(range(10))
    assert bounded_photos(sizes, 99) == [0, 2, 4, 6, 8]
    assert bounded_photos({3: 10, 7: 90}, 50) == [3] and bounded_photos({3: 60}, 50) == [] == bounded_photos({})
