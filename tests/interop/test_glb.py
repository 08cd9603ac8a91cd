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
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fastsplat.service.application.exporting.geometry_files import mesh_file
from fastsplat.service.scene.glb import GlbBuilder, linear, upright
from fastsplat.service.scene.ply import write_ply
from fastsplat.service.scene.splat_glb import EXTENSION, GlbScene, NamedRows, splat_glb
from fastsplat.service.scene.types import Gaussians
from fastsplat_contract.camera import Camera, PosedCamera
from tests.query.wall import wall_index

_DTYPES = {5126: "<f4", 5123: "<u2", 5121: "u1", 5125: "<u4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_SHAPES = {"ROTATION": "VEC4", "SCALE": "VEC3", "OPACITY": "SCALAR"}


def gaussians(degree: int = 3, count: int = 40) -> Gaussians:
    """Drawn ones of every shape, color and opacity."""
    rng = np.random.default_rng(5)

    def draw(*shape: int) -> NDArray[np.float32]:
        return rng.normal(size=shape).astype(np.float32)

    return Gaussians(
        means=2 * draw(count, 3),
        quats=3 * draw(count, 4),
        log_scales=draw(count, 3) - 3,
        logit_opacities=2 * draw(count),
        sh=0.4 * draw(count, (degree + 1) ** 2, 3),
        codes=np.zeros((count, 0), np.float32),
    )


def glb_parts(content: bytes) -> tuple[dict[str, Any], list[np.ndarray]]:
    """The document, and its accessors as arrays."""
    magic, version, size = struct.unpack_from("<4sII", content)
    assert (magic, version, size) == (b"glTF", 2, len(content))
    length = struct.unpack_from("<I", content, 12)[0]
    document = json.loads(content[20 : 20 + length])
    data = content[28 + length :]
    arrays = []
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        width, dtype = _WIDTHS[accessor["type"]], np.dtype(_DTYPES[accessor["componentType"]])
        stride = view.get("byteStride", width * dtype.itemsize)
        rows = np.frombuffer(data, np.uint8, accessor["count"] * stride, view["byteOffset"]).reshape(-1, stride)
        values = np.ascontiguousarray(rows[:, : width * dtype.itemsize]).view(dtype)
        arrays.append(values[:, 0] if width == 1 else values)
    return document, arrays


def _columns(document: dict[str, Any], arrays: list[np.ndarray], mesh: int) -> dict[str, np.ndarray]:
    (primitive,) = document["meshes"][mesh]["primitives"]
    return {name: arrays[number] for name, number in primitive["attributes"].items()}


@pytest.fixture
def about() -> GlbScene:
    pose = np.eye(4)
    pose[:3, 3] = 1, 2, 3
    camera = PosedCamera(Camera(64, 48, 50.0, 60.0, 30.0, 25.0), pose, "photos/<ü>.jpg")
    return GlbScene("a <scene>", {"units": "metres"}, np.array([0.0, 0.0, 1.0]), (camera,))


def test_splat_transform_writes_the_same_values(
    about: GlbScene, splat_transform: Callable[..., None], tmp_path: Path
) -> None:
    ours = gaussians()
    write_ply(ours, tmp_path / "a.ply")
    splat_transform(tmp_path / "a.ply", tmp_path / "a.glb")
    theirs = _columns(*glb_parts((tmp_path / "a.glb").read_bytes()), 0)
    document, arrays = glb_parts(splat_glb(ours, [NamedRows("all", {}, np.arange(len(ours)))], about))
    own = _columns(document, arrays, 0)
    assert set(own) == set(theirs)
    place = [int(np.abs(theirs["POSITION"] - p).sum(axis=1).argmin()) for p in _turned_by_half(own["POSITION"], theirs)]
    assert sorted(place) == list(range(len(ours)))
    for name in ("SCALE", "OPACITY", "SH_DEGREE_0_COEF_0"):
        np.testing.assert_allclose(own[f"{EXTENSION}:{name}"], theirs[f"{EXTENSION}:{name}"][place], rtol=1e-5)


def _turned_by_half(points: np.ndarray, theirs: dict[str, np.ndarray]) -> np.ndarray:
    """The points in the other program's frame, which may be turned by a half turn about one axis."""
    for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        turned = points * signs
        if np.allclose(np.sort(turned[:, 0]), np.sort(theirs["POSITION"][:, 0]), atol=1e-5) and np.allclose(
            np.sort(turned[:, 1]), np.sort(theirs["POSITION"][:, 1]), atol=1e-5
        ):
            return turned
    raise AssertionError("the positions differ")


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_the_file_is_what_the_extension_asks_for(
    degree: int, about: GlbScene, gltf_report: Callable[[Path], Any], tmp_path: Path
) -> None:
    ours = gaussians(degree)
    groups = [NamedRows("mug", {"thing": 7}, np.arange(0, 40, 2)), NamedRows("rest", {"thing": 0}, np.arange(1, 40, 2))]
    content = splat_glb(ours, groups, about)
    (tmp_path / "a.glb").write_bytes(content)
    messages = gltf_report(tmp_path / "a.glb")["messages"]
    # The validator was released before the extension, and does not know its attributes' names.
    unknown = [one for one in messages if f"/attributes/{EXTENSION}:" in one.get("pointer", "")]
    others = [one for one in messages if one not in unknown and one["code"] != "UNSUPPORTED_EXTENSION"]
    assert not others and {one["code"] for one in unknown} <= {"MESH_PRIMITIVE_INVALID_ATTRIBUTE"}

    document, arrays = glb_parts(content)
    assert document["extensionsUsed"] == [EXTENSION]
    for number, group in enumerate(groups):
        (primitive,) = document["meshes"][number]["primitives"]
        assert primitive["mode"] == 0
        assert primitive["extensions"][EXTENSION] == {
            "kernel": "ellipse",
            "colorSpace": "srgb_rec709_display",
            "projection": "perspective",
            "sortingMethod": "cameraDistance",
        }
        coefficients = [(one, n) for one in range(degree + 1) for n in range(2 * one + 1)]
        shapes = _SHAPES | {f"SH_DEGREE_{one}_COEF_{n}": "VEC3" for one, n in coefficients}
        attributes = primitive["attributes"]
        assert set(attributes) == {"POSITION", "COLOR_0", *(f"{EXTENSION}:{name}" for name in shapes)}
        for name, shape in shapes.items():
            accessor = document["accessors"][attributes[f"{EXTENSION}:{name}"]]
            assert (accessor["type"], accessor["componentType"]) == (shape, 5126)
        columns = _columns(document, arrays, number)
        np.testing.assert_array_equal(columns["POSITION"], ours.means[group.rows])
        np.testing.assert_allclose(np.linalg.norm(columns[f"{EXTENSION}:ROTATION"], axis=1), 1, rtol=1e-6)
        np.testing.assert_allclose(columns[f"{EXTENSION}:SCALE"], np.exp(ours.log_scales[group.rows]), rtol=1e-6)
        for place, (one, n) in enumerate(coefficients):
            np.testing.assert_array_equal(columns[f"{EXTENSION}:SH_DEGREE_{one}_COEF_{n}"], ours.sh[group.rows, place])
        w = ours.quats[group.rows, 0] / np.linalg.norm(ours.quats[group.rows], axis=1)
        np.testing.assert_allclose(columns[f"{EXTENSION}:ROTATION"][:, 3], w, atol=1e-6)


def test_trimesh_opens_the_points_by_name_upright(about: GlbScene, tmp_path: Path) -> None:
    ours = gaussians(1)
    groups = [NamedRows("mug", {"thing": 7}, np.arange(10)), NamedRows("rest", {"thing": 0}, np.arange(10, 40))]
    (tmp_path / "a.glb").write_bytes(splat_glb(ours, groups, about))
    opened = trimesh.load_scene(tmp_path / "a.glb")
    assert opened.graph["mug"][1] in opened.geometry and len(opened.geometry["mug"].vertices) == 10
    to_world = opened.graph["mug"][0]
    np.testing.assert_allclose(to_world[:3, :3] @ [0, 0, 1], [0, 1, 0], atol=1e-6)
    assert opened.graph.transforms.edge_data["a <scene>", "mug"]["metadata"]["thing"] == 7


def test_cameras_look_where_they_looked(about: GlbScene) -> None:
    (posed,) = about.cameras
    turned = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    pose = posed.world_from_camera.copy()
    pose[:3, :3] = turned
    about = replace(about, cameras=(replace(posed, world_from_camera=pose),))
    document, _ = glb_parts(splat_glb(gaussians(0), [NamedRows("all", {}, np.arange(40))], about))
    (node,) = (one for one in document["nodes"] if "camera" in one)
    assert node["name"] == "photos/<ü>.jpg" and node["translation"] == [1, 2, 3]
    axes = Rotation.from_quat(node["rotation"]).as_matrix()
    np.testing.assert_allclose(axes @ [0, 0, -1], turned @ [0, 0, 1], atol=1e-12)  # OpenGL's forward is OpenCV's
    np.testing.assert_allclose(axes @ [0, 1, 0], turned @ [0, -1, 0], atol=1e-12)
    lens = document["cameras"][node["camera"]]["perspective"]
    assert lens["yfov"] == pytest.approx(2 * np.arctan(24 / 60)) and lens["aspectRatio"] == pytest.approx(64 / 48)
    assert (node["extras"]["fx"], node["extras"]["cy"]) == (50, 25)
    (root,) = document["scenes"][document["scene"]]["nodes"]
    assert document["nodes"][root]["name"] == "a <scene>" and len(document["nodes"][root]["children"]) == 2


@pytest.mark.parametrize("up", [(0, 1, 0), (0, -1, 0), (0, 0, 1), (0.6, -0.8, 0), (-0.36, 0.48, 0.8)])
def test_up_becomes_y(up: tuple[float, float, float]) -> None:
    x, y, z, w = upright(np.array(up, float)) or ()
    axis, vector = np.array([x, y, z]), np.array(up, float)
    turned = vector + 2 * np.cross(axis, np.cross(axis, vector) + w * vector)
    np.testing.assert_allclose(turned, [0, 1, 0], atol=1e-9)
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
