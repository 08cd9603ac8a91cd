"""Points on surfaces, and the geometry of single views."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from plyfile import PlyData

from fastsplat.service.application.exporting.geometry_files import points_file
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.surfaces.surface_points import surface_points
from fastsplat.service.query.surfaces.surface_views import (
    SurfaceView,
    back_projected,
    observed,
    surface_views,
)
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, NotFoundError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.query.wall import DISTANCE, picture_of, wall_index


@pytest.fixture(scope="module")
def index() -> SceneIndex:
    return wall_index()


@pytest.fixture(scope="module")
def views(index: SceneIndex) -> tuple[SurfaceView, ...]:
    return surface_views(index)


def test_a_wall_has_its_normals_and_depth_and_confidence(index: SceneIndex) -> None:
    seen = index.geometry(index.scene.cameras[0])
    there = seen.depth > 0
    assert there.mean() > 0.5
    np.testing.assert_allclose(seen.depth[there], DISTANCE, atol=0.01)
    np.testing.assert_allclose(seen.median_depth[there], DISTANCE, atol=0.01)
    np.testing.assert_allclose(seen.normals[there], np.tile([0, 0, -1.0], (there.sum(), 1)), atol=0.02)
    assert (seen.spread[there] < 0.02).all() and (seen.confidence[there] > 0.4).all()
    assert not seen.normals[~there].any() and not seen.confidence[~there].any()


def test_confidence_falls_where_light_comes_from_several_depths() -> None:
    index = wall_index()
    scene = index.scene
    means = scene.gaussians.means.copy()
    before = (means[:, 0] < 0) & (np.indices((len(means),))[0] % 2 == 0)
    means[before, 2] -= 0.5  # half of the left half stands before the other
    torn = index.after(dataclasses.replace(scene, gaussians=dataclasses.replace(scene.gaussians, means=means)))
    seen = torn.geometry(scene.cameras[1])
    left, right = (slice(12, 36), slice(14, 26)), (slice(12, 36), slice(40, 52))
    shares = seen.spread / np.maximum(seen.depth, 1e-9)
    assert np.median(seen.confidence[left]) < 0.5 * np.median(seen.confidence[right])
    assert np.median(shares[left]) > 0.05 > np.median(shares[right])


def test_points_are_on_the_wall_with_their_objects_and_apart(views: tuple[SurfaceView, ...]) -> None:
    samples, cell = surface_points(views, cell=0.05, most=10**5, limit="")
    assert cell == 0.05 and len(samples) > 200
    np.testing.assert_allclose(samples.points[:, 2], DISTANCE, atol=0.02)
    np.testing.assert_allclose(samples.normals[:, 2], -1, atol=0.02)
    cells = np.unique(np.floor(samples.points / 0.05), axis=0)
    assert len(cells) == len(samples)
    left, right = samples.points[:, 0] < -0.1, samples.points[:, 0] > 0.1
    assert (samples.labels[left] == 1).all() and (samples.labels[right] == 2).all()
    assert set(samples.objects.tolist()) == {1, 2}
    assert (samples.colors[left, 0] > 150).all() and (samples.colors[right, 1] > 150).all()


def test_what_other_views_see_through_is_no_surface(views: tuple[SurfaceView, ...]) -> None:
    floating = np.array([[0, 0, 0.5 * DISTANCE], [0, 0, DISTANCE]], np.float32)
    samples = observed(floating, views, 0.05)
    assert samples.views[0] == 0 and samples.confidence[0] == 0
    assert samples.views[1] == len(views) and samples.confidence[1] > 0.4


def test_what_one_view_sees_or_more_see_through_than_see_is_left_out() -> None:
    depths = np.full((5, 8, 8), 2.0)
    depths[:2, 5, 5] = 1.0  # seen by two of five, the others look through it
    depths[1:, 1, 1] = 0.0  # seen by one, the others show nothing there
    samples, _ = surface_points([picture_of(depth) for depth in depths], cell=0.05, most=1_000, limit="")
    np.testing.assert_array_equal(samples.points[:, 2], 2.0)
    pixels = np.floor(samples.points[:, :2] / 2 * 8 + 4).astype(int)
    assert len(pixels) == 63 and [5, 5] in pixels.tolist() and [1, 1] not in pixels.tolist()


def test_coarser_cells_where_there_are_too_many_points_but_not_by_silence(views: tuple[SurfaceView, ...]) -> None:
    samples, cell = surface_points(views, cell=0, most=150, limit="")
    finest = surface_points(views, cell=0, most=10**6, limit="")[1]
    assert len(samples) <= 150 and cell > finest
    with pytest.raises(LimitExceededError) as refused:
        surface_points(views, cell=0.02, most=150, limit="150 points")
    assert refused.value.field == "cell" and refused.value.limit == "150 points"


def test_the_file_holds_points_labels_and_names(index: SceneIndex) -> None:
    import io

    content = points_file(index, 'a "table"\nelement vertex 9', (), 0.05)
    ply = PlyData.read(io.BytesIO(content))
    vertex = ply["vertex"]
    assert [column.name for column in vertex.properties] == (
        "x y z nx ny nz red green blue label object confidence".split()
    )
    comments = ply.comments
    assert 'units "metres"' in comments and "cell 0.05" in comments
    assert 'label 1 "red half"' in comments and 'object 2 "gr\\u00fcn\\nhalf"' in comments
    assert sum(line.startswith("scene ") for line in comments) == 1 and len(ply.elements) == 1
    half = PlyData.read(io.BytesIO(points_file(index, "", (2,), 0.05)))["vertex"]
    assert set(half["object"].tolist()) == {2} and half.count == (vertex["object"] == 2).sum()
    with pytest.raises(NotFoundError):
        points_file(index, "", (9,), 0.05)


def test_a_scene_without_cameras_has_no_surfaces() -> None:
    index = wall_index()
    index.scene = dataclasses.replace(index.scene, cameras=())
    with pytest.raises(InvalidInputError, match="without cameras"):
        points_file(index, "", (), 0.0)


def test_views_are_bounded_in_number_and_size() -> None:
    big = PosedCamera(Camera(960, 720, 900.0, 900.0, 480.0, 360.0), np.eye(4), "big.png")
    index = wall_index(QuerySettings(surface_views=2, surface_side=48), cameras=[big] * 5)
    views = surface_views(index)
    assert len(views) == 2 and views[0].depth.shape == (36, 48)
    points = back_projected(views[0])
    np.testing.assert_allclose(points[:, 2], DISTANCE, atol=0.02)
