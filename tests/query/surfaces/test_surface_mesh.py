"""Meshes of surfaces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from fastsplat.service.application.exporting.geometry_files import mesh_file
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.surfaces.surface_mesh import fused, surface_mesh, surface_net
from fastsplat.service.query.surfaces.surface_points import cell_keys
from fastsplat.service.query.surfaces.surface_views import surface_views
from fastsplat_contract.errors import LimitExceededError
from tests.query.wall import DISTANCE, picture_of, wall_index


@pytest.fixture(scope="module")
def index() -> SceneIndex:
    return wall_index()


def test_the_net_of_a_ball_is_closed_and_round_and_faces_outwards() -> None:
    steps = (np.stack(np.meshgrid(*[np.arange(-12, 12)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5) * 0.1
    keys, _ = cell_keys(steps, 0.1)
    order = np.argsort(keys)
    distances = np.linalg.norm(steps, axis=1) - 0.8
    points, faces = surface_net(keys[order], distances[order].astype(np.float32), 0.1)
    mesh = trimesh.Trimesh(points, faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.8**3, rel=0.02)  # negative, were it inside out
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.8, atol=0.01)


def test_distances_are_the_means_of_views_that_are_not_far_in_front(index: SceneIndex) -> None:
    offsets = np.array([0.1, 0.05, 0, -0.05, -0.5], np.float32)
    points = np.stack([np.zeros(5), np.zeros(5), DISTANCE - offsets], axis=1).astype(np.float32)
    distances = fused(points, surface_views(index), 0.1)
    np.testing.assert_allclose(distances[:4], [1, 0.5, 0, -0.5], atol=0.06)
    assert np.isnan(distances[4]) and np.isnan(fused(points + 50, surface_views(index), 0.1)).all()


def test_the_mesh_of_a_wall_lies_on_it_and_looks_at_the_cameras(index: SceneIndex) -> None:
    mesh = surface_mesh(surface_views(index), cell=0.04, most_points=10**5, most_voxels=10**6, limit="")
    np.testing.assert_allclose(mesh.vertices.points[:, 2], DISTANCE, atol=0.02)
    assert (mesh.vertices.normals[:, 2] < -0.9).all() and len(mesh.faces) > 300
    a, b, c = (mesh.vertices.points[mesh.faces[:, corner]] for corner in range(3))
    assert (np.cross(b - a, c - a)[:, 2] < 0).all()
    middle = (a + b + c)[:, 0] / 3
    assert (mesh.objects[middle < -0.1] == 1).all() and (mesh.objects[middle > 0.1] == 2).all()


def test_a_speck_is_no_part_of_a_mesh() -> None:
    depth = np.full((32, 32), 2.0)
    depth[14:18, 14:18] = 1.0
    mesh = surface_mesh([picture_of(depth)] * 2, cell=0.1, most_points=10_000, most_voxels=100_000, limit="")
    assert len(mesh.faces) > 300 and mesh.vertices.points[:, 2].min() > 1.8


def test_voxels_are_bounded(index: SceneIndex) -> None:
    views = surface_views(index)
    coarse = surface_mesh(views, cell=0, most_points=10**6, most_voxels=3_000, limit="")
    assert coarse.voxel > surface_mesh(views, cell=0, most_points=10**6, most_voxels=10**6, limit="").voxel
    with pytest.raises(LimitExceededError) as refused:
        surface_mesh(views, cell=0.02, most_points=10**6, most_voxels=3_000, limit="3000 voxels")
    assert refused.value.field == "cell" and refused.value.limit == "3000 voxels"


def test_a_stranger_finds_objects_by_name(index: SceneIndex, tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(mesh_file(index, "wall", (), 0.04))
    opened = trimesh.load_scene(tmp_path / "a.glb")
    assert set(opened.geometry) == {"red half", "grün\nhalf"}
    red = opened.geometry["red half"]
    assert (red.bounds[1, 0] - red.bounds[0, 0]) == pytest.approx(1, abs=0.15)
    colors = red.visual.vertex_attributes["color"]
    inner = red.vertices[:, 0] < -0.1
    assert (colors[inner, 0] > colors[inner, 1]).all()
    extras = opened.graph.transforms.edge_data["wall", "red half"]["metadata"]
    assert extras["object"] == 1 and extras["name"] == "red half" and extras["label"] == 1
    (tmp_path / "b.glb").write_bytes(mesh_file(index, "wall", (2,), 0.04))
    assert set(trimesh.load_scene(tmp_path / "b.glb").geometry) == {"grün\nhalf"}


def test_a_scene_that_shows_nothing_has_an_empty_mesh(tmp_path: Path) -> None:
    index = wall_index(QuerySettings(alpha_min=1.0))
    (tmp_path / "a.glb").write_bytes(mesh_file(index, "", (), 0.0))
    assert not trimesh.load_scene(tmp_path / "a.glb").geometry
