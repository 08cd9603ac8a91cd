"""Laws of edits: what they touch, what they leave, and how it looks afterwards."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.edits.edited_rows import edited_rows
from fastsplat.service.query.objects.solid_gaussians import masses
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Gaussians, Scene
from fastsplat_contract.errors import FastSplatError, InvalidInputError, LimitExceededError, NotFoundError
from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3, pose_of
from fastsplat_contract.messages.objects import SceneObject
from fastsplat_contract.messages.scenes import Edit
from tests.query.box_scenes import BoxShell, look, orbit, rigid, scene_of
from tests.query.conftest import opened
from tests.query.room import turned
from tests.scenes import evidence_from_dense

MUG = BoxShell("mug", (0.1, 0.1, 0.04))
BOOK = BoxShell("book", (-0.1, 0.0, 0.02), (0.2, 0.14, 0.04), yaw=-0.3, count=400)
FIELDS = tuple(Gaussians.__dataclass_fields__)
FRONT = look((0.1, -0.6, 0.4), (0, 0, 0), "front.jpg")
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@pytest.fixture
def scene() -> Scene:
    """A mug and a book, codes and evidence; degree 2."""
    base_scene = scene_of([MUG, BOOK], orbit(), degree=2)
    sums = np.zeros((len(base_scene.gaussians), 3))
    sums[: MUG.count, 1] = 5.0
    sums[MUG.count :, 2] = 3.0
    return replace(base_scene, evidence=evidence_from_dense(sums))


def rows_of(scene: Scene, rows: np.ndarray) -> Gaussians:
    return Gaussians(**{name: getattr(scene.gaussians, name)[rows] for name in FIELDS})


def assert_same(a: Gaussians, b: Gaussians, atol: float = 0.0) -> None:
    for name in FIELDS:
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=0, atol=atol, err_msg=name)


@pytest.mark.parametrize("mode", ["codes", "evidence"])
def test_removing_is_leaving_out_the_rows(scene: Scene, mode: Any) -> None:
    index = opened(scene if mode == "evidence" else replace(scene, evidence=None))
    removal = Edit("remove", label="Mugs")
    rows = np.setdiff1d(np.arange(len(scene.gaussians)), edited_rows(index, removal))
    assert not (index.gaussian_classes[rows] == 1).any()
    after = apply_edit(index, removal)
    assert_same(after.gaussians, rows_of(scene, rows))
    np.testing.assert_array_equal(opened(after).gaussian_classes, index.gaussian_classes[rows])
    without = replace(scene, gaussians=rows_of(scene, rows), evidence=None)
    np.testing.assert_array_equal(opened(after).render(FRONT), opened(without).render(FRONT))
    assert not opened(after).mask3d(opened(after).ask(["mug"])[0]).any()


def _mugs(index: SceneIndex) -> list[SceneObject]:
    return [obj for obj in index.objects.listed if obj.name == "mug"]


def test_an_edit_takes_along_what_an_object_encloses_and_nothing_beside_it() -> None:
    strays = np.array([3, 50, 120, 200])
    scene = scene_of([MUG, replace(BOOK, centre=(0.1, 0.01, 0.04))])  # side by side, 1 cm apart or nearer
    codes = scene.gaussians.codes.copy()
    codes[strays] = codes[-1]  # Gaussians of the mug with the book's label, and one that nobody labelled
    codes[7] = 0
    index = opened(replace(scene, gaussians=replace(scene.gaussians, codes=codes)))
    assert set(index.gaussian_classes[strays]) == {2} and index.gaussian_classes[7] == 0
    rows = edited_rows(index, Edit("remove", label="mug"))
    assert {*strays.tolist(), 7} <= set(rows.tolist()) and (np.diff(rows) > 0).all()
    assert len(np.setdiff1d(rows, np.arange(MUG.count))) <= 0.05 * BOOK.count
    (mug,) = _mugs(index)
    np.testing.assert_array_equal(edited_rows(index, Edit("remove", object_ids=(mug.id,))), rows)


def test_removing_an_object_leaves_its_twin(scene: Scene) -> None:
    two = opened(apply_edit(opened(scene), Edit("duplicate", label="mug", transform=pose_of(turned(0, 0.2)))))
    first, second = _mugs(two)
    (left,) = _mugs(opened(apply_edit(two, Edit("remove", object_ids=(first.id,)))))
    np.testing.assert_allclose(left.centroid, second.centroid, atol=1e-6)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_moving_there_and_back_is_nothing(degree: int) -> None:
    scene = scene_of([MUG, BOOK], orbit(), degree=degree)
    pose = rigid(degree)
    there = apply_edit(opened(scene), Edit("move", label="mug", transform=pose_of(pose)))
    back = apply_edit(opened(there), Edit("move", label="mug", transform=pose_of(np.linalg.inv(pose))))
    sign = np.sign((back.gaussians.quats * scene.gaussians.quats).sum(axis=1, keepdims=True))  # q and −q turn alike
    assert_same(replace(back.gaussians, quats=back.gaussians.quats * sign), scene.gaussians, atol=1e-5)
    rows = np.arange(MUG.count, MUG.count + BOOK.count)
    assert_same(rows_of(there, rows), rows_of(scene, rows))
    assert np.abs(there.gaussians.means[: MUG.count] - scene.gaussians.means[: MUG.count]).max() > 0.1
    np.testing.assert_array_equal(opened(there).gaussian_classes, opened(scene).gaussian_classes)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_turned_object_looks_the_same_to_a_turned_camera(degree: int) -> None:
    scene = scene_of([MUG], degree=degree)
    pose = rigid(10 + degree)
    moved = apply_edit(opened(scene), Edit("move", label="mug", transform=pose_of(pose)))
    turned = replace(FRONT, world_from_camera=pose @ FRONT.world_from_camera)
    before = opened(scene).render(FRONT).astype(int)
    after = opened(moved).render(turned).astype(int)
    assert before.std() > 10
    assert np.abs(after - before).max() <= 2 and (after != before).mean() < 0.02
    if degree:  # colors that stay behind would be seen
        stiff = replace(moved, gaussians=replace(moved.gaussians, sh=scene.gaussians.sh))
        assert np.abs(opened(stiff).render(turned).astype(int) - before).max() > 20


def test_a_duplicate_comes_after_all_rows_and_the_original_stays(scene: Scene) -> None:
    index = opened(scene)
    pose, count = rigid(5), len(scene.gaussians)
    rows = edited_rows(index, Edit("duplicate", label="mug", transform=pose_of(pose)))
    after = apply_edit(index, Edit("duplicate", label="mug", transform=pose_of(pose)))
    assert len(after.gaussians) == count + len(rows) == len(after.evidence or ())
    assert_same(rows_of(after, np.arange(count)), scene.gaussians)
    moved = apply_edit(index, Edit("move", label="mug", transform=pose_of(pose)))
    assert_same(rows_of(after, np.arange(count, len(after.gaussians))), rows_of(moved, rows))
    np.testing.assert_array_equal(
        opened(after).gaussian_classes, np.append(index.gaussian_classes, index.gaussian_classes[rows])
    )


@pytest.mark.parametrize("color", [(0.9, 0.2, 0.1), (0.0, 0.5, 1.0), (1.0, 1.0, 1.0), (0.2, 0.2, 0.2)])
def test_recoloring_sets_the_mean_and_keeps_the_shading(scene: Scene, color: tuple[float, float, float]) -> None:
    index = opened(scene)
    rows = np.flatnonzero(index.gaussian_classes == 1)
    after = apply_edit(index, Edit("recolor", label="mug", color=color))
    part, old = rows_of(after, rows), rows_of(scene, rows)
    weights = masses(part.log_scales, part.logit_opacities)
    base = 0.5 + 0.28209479177387814 * part.sh[:, 0].astype(float)
    np.testing.assert_allclose(np.average(base, axis=0, weights=weights), color, atol=1e-5)
    shade, before = base @ LUMINANCE, old.sh[:, 0].astype(float) @ LUMINANCE
    assert np.corrcoef(shade, before)[0, 1] > 0.9999
    assert_same(replace(part, sh=old.sh), old)
    rest = np.setdiff1d(np.arange(len(scene.gaussians)), rows)
    assert_same(rows_of(after, rest), rows_of(scene, rest))
    again = apply_edit(opened(after), Edit("recolor", label="mug", color=color))
    np.testing.assert_allclose(again.gaussians.sh, after.gaussians.sh, atol=1e-4)


def test_recoloring_black_does_not_blow_up() -> None:
    scene = scene_of([MUG], degree=1)
    sh = scene.gaussians.sh.copy()
    sh[:, 0] = -0.5 / 0.28209479177387814
    black = replace(scene, gaussians=replace(scene.gaussians, sh=sh))
    red = apply_edit(opened(black), Edit("recolor", label="mug", color=(1.0, 0.0, 0.0)))
    assert np.isfinite(red.gaussians.sh).all() and np.abs(red.gaussians.sh).max() < 10 * np.abs(sh).max()


_EDITS = (
    Edit("remove", label="mug"),
    Edit("recolor", label="mug", color=(1, 0, 0)),
    Edit("move", label="mug", transform=pose_of(rigid(0))),
    Edit("duplicate", label="mug", transform=pose_of(rigid(0))),
)


def test_an_edit_leaves_the_index_as_it_was(scene: Scene) -> None:
    index = opened(scene)
    before = {name: getattr(scene.gaussians, name).copy() for name in FIELDS}
    for edit in _EDITS:
        apply_edit(index, edit)
        assert_same(index.scene.gaussians, Gaussians(**before))


def test_what_has_no_gaussians_can_be_edited(scene: Scene) -> None:
    index = opened(apply_edit(opened(scene), Edit("remove", label="mug")))
    for edit in _EDITS:
        assert_same(apply_edit(index, edit).gaussians, index.scene.gaussians)


STILL = Vector3(0, 0, 0)
STRETCHED, NAN = Pose(STILL, Quaternion(0, 0, 1, 1)), Pose(STILL, Quaternion(0, 0, np.nan, 1))


@pytest.mark.parametrize(
    ("edit", "error", "field"),
    [
        (Edit("remove", label="submarine"), NotFoundError, "label"),
        (Edit("remove", object_ids=(9,)), NotFoundError, "object_ids[0]"),
        (Edit("remove"), InvalidInputError, "label"),
        (Edit("remove", label="mug", object_ids=(1,)), InvalidInputError, "label"),
        (Edit("paint", label="mug"), InvalidInputError, "action"),
        (Edit("recolor", label="mug"), InvalidInputError, "color"),
        (Edit("recolor", label="mug", color=(2, 0, 0)), InvalidInputError, "color"),
        (Edit("recolor", label="mug", color=(np.nan, 0, 0)), InvalidInputError, "color"),
        (Edit("remove", label="mug", color=(1, 0, 0)), InvalidInputError, "color"),
        (Edit("move", label="mug"), InvalidInputError, "transform"),
        (Edit("recolor", label="mug", color=(1, 0, 0), transform=pose_of(np.eye(4))), InvalidInputError, "transform"),
        (Edit("move", label="mug", transform=STRETCHED), InvalidInputError, "transform"),
        (Edit("duplicate", label="mug", transform=NAN), InvalidInputError, "transform"),
    ],
)
def test_what_cannot_be_done(scene: Scene, edit: Edit, error: type[FastSplatError], field: str) -> None:
    with pytest.raises(error) as caught:
        apply_edit(opened(scene), edit)
    assert caught.value.field == field


def test_duplicates_that_double_a_scene_again_and_again_are_bounded(scene: Scene) -> None:
    edit, limit = Edit("duplicate", label="mug", transform=pose_of(turned(0, 0.01))), 3 * len(scene.gaussians)
    error: LimitExceededError | None = None
    for _ in range(20):
        try:
            scene = apply_edit(opened(scene), edit, max_gaussians=limit)
        except LimitExceededError as refusal:
            error = refusal
            break
    assert error is not None and error.field == "action" and len(scene.gaussians) <= limit
