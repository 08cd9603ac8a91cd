"""GLB files, read by programs that are not ours."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fastsplat.service.application.exporting.geometry_files import mesh_file
from fastsplat.service.scene.formats.glb import GlbBuilder, GlbScene, finished, linear, upright
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.query.wall import wall_index

_DTYPES = {5126: "<f4", 5123: "<u2", 5121: "u1", 5125: "<u4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def glb_parts(content: bytes) -> tuple[dict[str, Any], list[np.ndarray]]:
    """The document, and its accessors as arrays."""
    magic, version, size = struct.unpack_from("<4sII", content)
    assert (magic, version, size) == (b"glTF", 2, len(content))
    length = struct.unpack_from("<I", content, 12)[0]
    document = json.loads(content[20 : 20 + length])
    data = content[28 + length :]
    arrays = []
    for accessor in document.get("accessors", ()):
        view = document["bufferViews"][accessor["bufferView"]]
        width, dtype = _WIDTHS[accessor["type"]], np.dtype(_DTYPES[accessor["componentType"]])
        stride = view.get("byteStride", width * dtype.itemsize)
        rows = np.frombuffer(data, np.uint8, accessor["count"] * stride, view["byteOffset"]).reshape(-1, stride)
        values = np.ascontiguousarray(rows[:, : width * dtype.itemsize]).view(dtype)
        arrays.append(values[:, 0] if width == 1 else values)
    return document, arrays


@pytest.fixture
def about() -> GlbScene:
    pose = np.eye(4)
    pose[:3, 3] = 1, 2, 3
    camera = PosedCamera(Camera(64, 48, 50.0, 60.0, 30.0, 25.0), pose, "photos/<ü>.jpg")
    return GlbScene("a <scene>", {"units": "metres"}, np.array([0.0, 0.0, 1.0]), (camera,))


def test_cameras_look_where_they_looked(about: GlbScene) -> None:
    (posed,) = about.cameras
    turned = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    pose = posed.world_from_camera.copy()
    pose[:3, :3] = turned
    about = replace(about, cameras=(replace(posed, world_from_camera=pose),))
    document, _ = glb_parts(finished(GlbBuilder("x"), [], about))
    (node,) = (node for node in document["nodes"] if "camera" in node)
    assert node["name"] == "photos/<ü>.jpg" and node["translation"] == [1, 2, 3]
    axes = Rotation.from_quat(node["rotation"]).as_matrix()
    np.testing.assert_allclose(axes @ [0, 0, -1], turned @ [0, 0, 1], atol=1e-12)  # OpenGL's forward is OpenCV's
    np.testing.assert_allclose(axes @ [0, 1, 0], turned @ [0, -1, 0], atol=1e-12)
    lens = document["cameras"][node["camera"]]["perspective"]
    assert lens["yfov"] == pytest.approx(2 * np.arctan(24 / 60)) and lens["aspectRatio"] == pytest.approx(64 / 48)
    assert (node["extras"]["fx"], node["extras"]["cy"]) == (50, 25)
    (root,) = document["scenes"][document["scene"]]["nodes"]
    assert document["nodes"][root]["rotation"] == upright(about.up)
    assert document["nodes"][root]["name"] == "a <scene>" and len(document["nodes"][root]["children"]) == 1


@pytest.mark.parametrize("up", [(0, 1, 0), (0, -1, 0), (0, 0, 1), (0.6, -0.8, 0), (-0.36, 0.48, 0.8)])
def test_up_becomes_y(up: tuple[float, float, float]) -> None:
    turn = Rotation.from_quat(upright(np.array(up, float)) or ())
    np.testing.assert_allclose(turn.apply(up), [0, 1, 0], atol=1e-9)
    assert upright(None) is None


def test_colors_are_linear_and_short_rows_padded() -> None:
    np.testing.assert_array_equal(linear(np.array([-1, 0, 1, 2])), [0, 0, 65_535, 65_535])
    assert abs(linear(np.array([0.5]))[0] / 65_535 - 0.21404) < 1e-4
    builder = GlbBuilder("x")
    values = np.arange(9, dtype=np.uint8).reshape(3, 3)
    builder.accessor(values)
    builder.accessor(np.arange(3, dtype=np.uint16), target=None)
    _, arrays = glb_parts(builder.file())
    np.testing.assert_array_equal(arrays[0], values)
    np.testing.assert_array_equal(arrays[1], [0, 1, 2])


def test_the_khronos_validator_finds_nothing_in_a_mesh(gltf_report: Callable[[Path], Any], tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(mesh_file(wall_index(), "wall", (), 0.04))
    report = gltf_report(tmp_path / "a.glb")
    assert not [message for message in report["messages"] if message["severity"] < 2]
    assert report["info"]["totalTriangleCount"] > 300 and report["info"]["extensionsUsed"] == ["KHR_materials_unlit"]
