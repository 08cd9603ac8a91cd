"""The zips of cameras, with and without points, opened by pycolmap."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from plyfile import PlyData

from fastsplat.service.application.exporting.camera_files import colmap
from fastsplat.service.application.exporting.geometry_files import cameras_file
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.query.wall import wall_index


def _opened(content: bytes, folder: Path, within: str, cameras: Sequence[PosedCamera]) -> pycolmap.Reconstruction:
    """The model in a zip, which has these lenses and poses."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(folder)
    model = pycolmap.Reconstruction(folder / within)
    assert len(model.images) == len(cameras)
    for image in model.images.values():
        (posed,) = (posed for posed in cameras if posed.name == image.name)
        assert image.cam_from_world().matrix() == pytest.approx(posed.camera_from_world()[:3], abs=1e-12)
        lens = model.cameras[image.camera_id]
        assert lens.params.tolist() == [posed.camera.fx, posed.camera.fy, posed.camera.cx, posed.camera.cy]
        assert (lens.width, lens.height, lens.model.name) == (posed.camera.width, posed.camera.height, "PINHOLE")
    return model


def test_pycolmap_and_nerfstudio_find_cameras_and_points(tmp_path: Path) -> None:
    pose = np.eye(4)
    pose[:3, :3] = [[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]]
    pose[:3, 3] = -0.5, 0.1, 0.2
    cameras = [
        PosedCamera(Camera(64, 48, 60.0, 61.0, 31.0, 25.0), np.eye(4), "photos/left & ü.png"),
        PosedCamera(Camera(64, 48, 60.0, 61.0, 31.0, 25.0), pose, "b.png"),
        PosedCamera(Camera(32, 24, 30.0, 30.0, 16.0, 12.0), np.eye(4), "c.png"),
    ]
    index = wall_index(cameras=cameras)
    content = cameras_file(index, "wall", (), 0.05)
    assert content == cameras_file(index, "wall", (), 0.05)
    model = _opened(content, tmp_path, "sparse/0", cameras)
    assert len(model.cameras) == 2
    transforms = json.loads((tmp_path / "transforms.json").read_text())
    assert [frame["file_path"] for frame in transforms["frames"]] == [posed.name for posed in cameras]
    vertices = PlyData.read(tmp_path / transforms["ply_file_path"])["vertex"]
    assert len(model.points3D) == vertices.count > 100
    for number in (1, vertices.count):
        row, point = vertices[number - 1], model.points3D[number]
        assert point.xyz.tolist() == pytest.approx([row["x"], row["y"], row["z"]])
        assert point.color.tolist() == [row["red"], row["green"], row["blue"]]
    _opened(colmap(cameras[1:]), tmp_path, "", cameras[1:])
    assert colmap(cameras[1:]) == colmap(cameras[1:])
