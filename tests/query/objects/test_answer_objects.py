"""Laws of objects: counts, boxes that move along, ids that stay, views that see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.scene.objects.boxes import oriented_box
from fastsplat_contract.geometry.poses import pose_of
from fastsplat_contract.messages.objects import SceneObject
from fastsplat_contract.messages.scenes import Edit
from tests.query.box_scenes import BoxShell, look, orbit, rigid, scene_of, with_cameras_moved
from tests.query.conftest import plain_index_of

MUG = BoxShell("mug", (0.2, 0.1, 0.04), yaw=0.5)
BOOK = BoxShell("book", (-0.2, 0.0, 0.02), (0.2, 0.14, 0.04), yaw=-0.3, count=500)
TABLE = BoxShell("table", (0.0, 0.0, -0.02), (1.2, 0.8, 0.02), count=2000)


def named(index: SceneIndex, label: str) -> tuple[SceneObject, ...]:
    return index.objects_of(index.ask([label])[0])


def test_each_object_is_one_object_with_its_place_and_size() -> None:
    index = plain_index_of(scene_of([MUG, BOOK, TABLE], orbit()))
    assert [(obj.name, obj.label_id) for obj in index.objects.listed] == [("mug", 1), ("book", 2), ("table", 3)]
    for obj, truth in zip(index.objects.listed, (MUG, BOOK, TABLE), strict=True):
        assert obj.meters and obj.gaussian_count == truth.count
        assert index.objects.rows([obj.id]).sum() == truth.count
        assert 0.99 < obj.probability <= 1
        np.testing.assert_allclose(obj.centroid, truth.centre, atol=0.1 * max(truth.size))
        np.testing.assert_allclose(obj.box.center.position, truth.centre, atol=0.05 * max(truth.size))
        np.testing.assert_allclose(obj.box.size, truth.size, rtol=0.1, atol=1e-3)
        axes = Rotation.from_quat(obj.box.center.orientation).as_matrix()
        np.testing.assert_allclose(axes[:, 2], [0, 0, 1], atol=1e-6)
        assert abs(axes[:, 0] @ [np.cos(truth.yaw), np.sin(truth.yaw), 0]) > 0.99


def test_the_objects_of_an_answer_lie_inside_its_mask() -> None:
    stray = BoxShell("mug", (3.0, 0, 0), (0.01, 0.01, 0.01), count=2)
    small = replace(MUG, centre=(0.6, 0.1, 0.04), count=100)
    index = plain_index_of(scene_of([small, MUG, stray, BOOK, TABLE]))
    for answer in index.ask(["where are the mugs?", "book", "submarine"]):
        mask = index.mask3d(answer)
        objects = index.objects_of(answer)
        sizes = [obj.gaussian_count for obj in objects]
        assert sizes == sorted(sizes, reverse=True)
        rows = index.objects.rows([obj.id for obj in objects])
        assert mask[rows].all() and sum(obj.gaussian_count for obj in objects) == rows.sum()
        assert rows.sum() == mask.sum() - (2 if "mugs" in answer.text else 0)


def test_a_speck_is_no_object_and_a_large_rest_is() -> None:
    for count, objects in ((14, 1), (16, 2)):
        far = BoxShell("mug", (1.0, 0, 0), (0.02, 0.02, 0.02), count=count)
        assert len(named(plain_index_of(scene_of([MUG, far])), "mug")) == objects


def test_a_giant_between_two_objects_does_not_join_them() -> None:
    scene = scene_of(
        [MUG, replace(MUG, centre=(-0.2, 0.1, 0.04)), BoxShell("mug", (0, 0.1, 0.04), (1e-3,) * 3, count=1)]
    )
    gaussians = scene.gaussians
    log_scales = gaussians.log_scales.copy()
    log_scales[-1] = np.log(0.5)
    assert len(plain_index_of(replace(scene, gaussians=replace(gaussians, log_scales=log_scales))).objects.listed) == 2


def test_dense_clumps_hang_together_with_what_they_touch() -> None:
    scene = scene_of([replace(MUG, count=1200)])
    means = scene.gaussians.means.copy()
    rng = np.random.default_rng(0)
    means[300:] = np.repeat(means[:30], 30, axis=0) + rng.normal(0, 1e-5, (900, 3))  # each has neighbours of its own
    gaussians = replace(scene.gaussians, means=means, log_scales=scene.gaussians.log_scales + np.float32(np.log(2)))
    assert len(plain_index_of(replace(scene, gaussians=gaussians)).objects.listed) == 1


def test_gaussians_in_one_place_are_one_object() -> None:
    scene = scene_of([replace(MUG, count=20_000)])
    gaussians = replace(scene.gaussians, means=np.ones_like(scene.gaussians.means))
    (mug,) = plain_index_of(replace(scene, gaussians=gaussians)).objects.listed
    assert mug.gaussian_count == 20_000
    np.testing.assert_allclose(mug.box.size, 0, atol=1e-6)


def test_what_is_not_finite_belongs_to_nothing_and_what_is_almost_transparent_has_no_place() -> None:
    scene = scene_of([MUG])
    logit_opacities = scene.gaussians.logit_opacities.copy()
    logit_opacities[:10] = -5.0
    means = scene.gaussians.means.copy()
    means[20] = np.nan
    gaussians = replace(scene.gaussians, logit_opacities=logit_opacities, means=means)
    index = plain_index_of(replace(scene, gaussians=gaussians))
    (mug,) = index.objects.listed
    assert mug.gaussian_count == MUG.count - 1 and not index.objects.rows([mug.id])[20]
    seen = np.setdiff1d(np.arange(MUG.count), [*range(10), 20])
    rest = {name: array[seen] for name, array in vars(scene.gaussians).items()}
    (alone,) = plain_index_of(replace(scene, gaussians=Gaussians(**rest))).objects.listed
    assert mug.box == alone.box and mug.centroid == alone.centroid


def test_nothing_has_no_objects() -> None:
    scene = scene_of([MUG])
    unlabelled = replace(scene.gaussians, codes=np.zeros_like(scene.gaussians.codes))
    none = {name: getattr(scene.gaussians, name)[:0] for name in scene.gaussians.__dataclass_fields__}
    for gaussians in (unlabelled, replace(scene.gaussians, **none)):
        index = plain_index_of(replace(scene, gaussians=gaussians))
        assert index.objects.listed == () and named(index, "mug") == ()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_gaussians_still_have_a_box(count: int) -> None:
    (mug,) = plain_index_of(scene_of([replace(MUG, size=(1e-3, 1e-3, 1e-3), count=count)], orbit())).objects.listed
    assert mug.gaussian_count == count
    assert np.isfinite([*mug.box.center.position, *mug.box.size, *mug.box.center.orientation]).all()
    assert np.linalg.norm(mug.box.center.orientation) == pytest.approx(1)


@pytest.mark.parametrize("seed", range(4))
def test_boxes_move_along_with_the_scene(seed: int) -> None:
    pose = rigid(seed)
    scene = scene_of([MUG, BOOK, TABLE], orbit())
    moved = scene
    for label in ("mug", "book", "table"):
        moved = apply_edit(plain_index_of(moved), Edit("move", label=label, transform=pose_of(pose)))
    moved = with_cameras_moved(moved, pose)
    still, there = plain_index_of(scene), plain_index_of(moved)
    np.testing.assert_array_equal(still.objects.owner, there.objects.owner)
    for a, b in zip(still.objects.listed, there.objects.listed, strict=True):
        assert a.id == b.id and still.objects.best_views([a.id]) == there.objects.best_views([b.id])
        np.testing.assert_allclose(pose[:3, :3] @ a.centroid + pose[:3, 3], b.centroid, atol=1e-5)
        np.testing.assert_allclose(pose[:3, :3] @ a.box.center.position + pose[:3, 3], b.box.center.position, atol=1e-4)
        np.testing.assert_allclose(a.box.size, b.box.size, atol=2e-4)
        turned = pose[:3, :3] @ Rotation.from_quat(a.box.center.orientation).as_matrix()
        cosines = np.abs(np.diag(turned.T @ Rotation.from_quat(b.box.center.orientation).as_matrix()))
        np.testing.assert_allclose(cosines, 1, atol=1e-3)  # a box is itself when an axis points the other way


def test_boxes_without_cameras_follow_the_spread() -> None:
    flat = BoxShell("book", (1, 2, 3), (0.2, 0.14, 0.02), yaw=0.4, count=600)
    pose = rigid(7)
    (a,) = plain_index_of(scene_of([flat])).objects.listed
    (b,) = plain_index_of(
        apply_edit(plain_index_of(scene_of([flat])), Edit("move", label="book", transform=pose_of(pose)))
    ).objects.listed
    np.testing.assert_allclose(a.box.size, flat.size, rtol=0.1, atol=2e-3)
    np.testing.assert_allclose(a.box.size, b.box.size, atol=2e-4)


def test_a_few_strays_do_not_stretch_a_box() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (1000, 3)) * (0.5, 0.3, 0.2)
    points[:10] += rng.normal(0, 20, (10, 3))
    box = oriented_box(points, np.ones(1000), np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(box.size, (1.0, 0.6, 0.4), rtol=0.1)


def test_best_views_look_at_the_object_and_nothing_stands_between() -> None:
    wall = BoxShell("wall", (0, 0.4, 0.1), (1.0, 0.02, 0.6), count=9000)
    mug = BoxShell("mug", (0, 0, 0.05))
    cameras = [
        look((0, 1.0, 0.1), (0, 0, 0.1), "hidden.jpg"),
        look((0, -3.0, 0.1), (0, 0, 0.1), "far.jpg"),
        look((0, -1.0, 0.1), (0, 0, 0.1), "near.jpg"),
        look((0, -1.0, 0.1), (0, -2, 0.1), "away.jpg"),
        look((1.0, -0.2, 0.1), (0, 0, 0.1), ""),
    ]
    index = plain_index_of(scene_of([mug, wall], cameras))
    assert named(index, "mug")[0].best_views == ("near.jpg", "far.jpg")
    many = plain_index_of(scene_of([mug], orbit(100)))
    assert len(named(many, "mug")[0].best_views) == 5
    assert named(plain_index_of(scene_of([mug])), "mug")[0].best_views == ()
