"""Laws of removing by a filter: a preview is what goes, what a box leaves lies in it, and all criteria hold at once."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import expit, logit

from fastsplat.service.query.edits.apply_edit import apply_edit, preview_of
from fastsplat.service.query.edits.edited_rows import inside
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Gaussians, Scene
from fastsplat.service.scene.gaussians.connectivity import isolation
from fastsplat.service.scene.objects.objects import object_rows
from fastsplat_contract.errors import FastSplatError, InvalidInputError
from fastsplat_contract.geometry.gaussian_filters import GaussianFilter
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3, pose_of
from fastsplat_contract.messages.scenes import Edit
from tests.query.box_scenes import BoxShell, orbit, rigid, scene_of
from tests.query.conftest import opened
from tests.scenes import evidence_from_dense

MUG = BoxShell("mug", (0.1, 0.1, 0.04), count=60)
BOOK = BoxShell("book", (-0.1, 0.0, 0.02), (0.2, 0.14, 0.04), yaw=-0.3, count=80)
FLOATERS = 5
UPRIGHT = Quaternion(0.0, 0.0, 0.0, 1.0)
MUG_BOX = Box(Pose(Vector3(0.1, 0.1, 0.04), UPRIGHT), Vector3(0.12, 0.08, 0.1))
FIELDS = tuple(Gaussians.__dataclass_fields__)


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A mug, a book, and floaters with the book's label two meters above; opacities of all kinds; evidence."""
    base_scene = scene_of([MUG, BOOK], orbit())
    rng = np.random.default_rng(3)
    gaussians = base_scene.gaussians
    means = gaussians.means.copy()
    means[-FLOATERS:] = rng.normal((0.0, 0.0, 2.0), 0.3, (FLOATERS, 3))
    opacities = logit(rng.uniform(0.02, 0.98, len(means))).astype(np.float32)
    sums = np.zeros((len(means), 3))
    sums[: MUG.count, 1], sums[MUG.count :, 2] = 5.0, 3.0
    gaussians = replace(gaussians, means=means, logit_opacities=opacities)
    return replace(base_scene, gaussians=gaussians, evidence=evidence_from_dense(sums))


@pytest.fixture(scope="module")
def index(scene: Scene) -> SceneIndex:
    labeled = opened(scene)
    return labeled.after(labeled.objects.scene)


def crop(box: Box = MUG_BOX) -> Edit:
    return Edit("remove", filter=GaussianFilter(box=box, outside=True))


def below(opacity: float, **target: Any) -> Edit:
    return Edit("remove", filter=GaussianFilter(opacity_below=opacity), **target)


def floaters(isolation_above: float) -> Edit:
    return Edit("remove", filter=GaussianFilter(isolation_above=isolation_above))


@pytest.mark.parametrize(
    "edits",
    [
        (crop(),),
        (below(0.3),),
        (floaters(4.0),),
        (below(0.5, object_ids=(1,)),),
        (below(0.5, label="book"), floaters(4.0), crop(replace(MUG_BOX, size=Vector3(0.3, 9.0, 9.0)))),
        (Edit("remove", label="mug"), below(0.2)),
    ],
)
def test_a_preview_is_what_goes(index: SceneIndex, scene: Scene, edits: tuple[Edit, ...]) -> None:
    preview = preview_of(index, "1", edits)
    after = index
    for edit, count in zip(edits, preview.counts, strict=True):
        before, after = after, after.after(apply_edit(after, edit))
        assert len(before.scene.gaussians) - len(after.scene.gaussians) == count > 0
    stays = ~preview.array()
    assert (preview.gaussians, preview.count) == (len(scene.gaussians), int((~stays).sum()))
    for name in FIELDS:
        np.testing.assert_array_equal(
            getattr(after.scene.gaussians, name), getattr(scene.gaussians, name)[stays], err_msg=name
        )
    assert after.scene.objects is not None
    owner = object_rows(index.objects.table)
    np.testing.assert_array_equal(object_rows(after.scene.objects), owner[stays])
    assert [obj.id for obj in after.scene.objects.table] == [obj.id for obj in index.objects.table.table]
    np.testing.assert_array_equal(after.gaussian_classes, index.gaussian_classes[stays])


@given(seed=st.integers(0, 999), size=st.floats(0.05, 0.4))
def test_a_crop_leaves_nothing_outside_of_the_box_and_all_that_is_in_it(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.5, 0.5, (300, 3)).astype(np.float32)
    pose = rigid(seed)
    box = Box(pose_of(pose), Vector3(size, 2 * size, size / 2))
    along = (np.linalg.inv(pose) @ np.c_[points, np.ones(300)].T)[:3].T
    truly = (np.abs(along) <= np.array([size, 2 * size, size / 2]) / 2).all(axis=1)
    edge = np.abs(np.abs(along) - np.array([size, 2 * size, size / 2]) / 2).min(axis=1) < 1e-6
    np.testing.assert_array_equal(inside(box, points)[~edge], truly[~edge])


def test_a_box_removes_what_lies_in_it_and_its_outside_the_rest(index: SceneIndex) -> None:
    within = preview_of(index, "1", [Edit("remove", filter=GaussianFilter(box=MUG_BOX))]).array()
    without = preview_of(index, "1", [crop()]).array()
    np.testing.assert_array_equal(within, ~without)
    np.testing.assert_array_equal(np.flatnonzero(within), np.arange(MUG.count))


def test_a_center_that_is_not_finite_lies_outside_and_is_a_floater(scene: Scene) -> None:
    means = scene.gaussians.means.copy()
    means[0], means[1] = np.nan, np.inf
    broken = replace(scene.gaussians, means=means)
    assert not inside(replace(MUG_BOX, size=Vector3(1e9, 1e9, 1e9)), means)[:2].any()
    assert np.isinf(isolation(broken)[:2]).all() and np.isfinite(isolation(broken)[2:]).all()


def test_all_that_a_filter_says_holds_at_once(index: SceneIndex, scene: Scene) -> None:
    both = GaussianFilter(box=MUG_BOX, opacity_below=0.4)
    mask = preview_of(index, "1", [Edit("remove", filter=both, object_ids=(1,))]).array()
    opacities = expit(scene.gaussians.logit_opacities.astype(np.float64))
    mug = object_rows(index.objects.table) == 1
    np.testing.assert_array_equal(mask, mug & inside(MUG_BOX, scene.gaussians.means) & (opacities < 0.4))


def test_what_hangs_in_the_air_is_isolated_whatever_the_unit(scene: Scene) -> None:
    measured = isolation(scene.gaussians)
    assert measured[-FLOATERS:].min() > 4 > measured[:-FLOATERS].max()
    scaled = replace(scene.gaussians, means=scene.gaussians.means * np.float32(64))
    np.testing.assert_allclose(isolation(scaled), measured, rtol=1e-4)
    np.testing.assert_array_equal(isolation(_rows(scene.gaussians, 1)), [0])
    assert len(isolation(_rows(scene.gaussians, 0))) == 0


def test_later_edits_of_a_request_see_what_the_earlier_left(index: SceneIndex) -> None:
    everything = Edit("remove", filter=GaussianFilter(opacity_below=1.0))
    preview = preview_of(index, "1", [below(0.5), below(0.5), everything, below(0.9)])
    assert preview.counts[1] == preview.counts[3] == 0
    assert preview.counts[0] + preview.counts[2] == preview.count == preview.gaussians


@pytest.mark.parametrize(
    ("edit", "error", "field"),
    [
        (crop(replace(MUG_BOX, size=Vector3(1.0, -1.0, 1.0))), InvalidInputError, "filter.box.size"),
        (below(0.5, object_ids=(1,), label="mug"), InvalidInputError, "label"),
        (Edit("discard", object_ids=(1,), filter=GaussianFilter(opacity_below=0.5)), InvalidInputError, "filter"),
    ],
)
def test_what_makes_no_sense_is_refused_by_its_field(
    index: SceneIndex, edit: Edit, error: type[FastSplatError], field: str
) -> None:
    with pytest.raises(error) as raised:
        apply_edit(index, edit)
    assert raised.value.field == field


def test_nothing_is_left_is_refused_without_a_filter_too(index: SceneIndex) -> None:
    rest = index.after(apply_edit(index, crop()))
    with pytest.raises(InvalidInputError) as raised:
        apply_edit(rest, Edit("remove", object_ids=(1,)))
    assert raised.value.field == "object_ids"


def test_only_removing_has_a_preview(index: SceneIndex) -> None:
    with pytest.raises(InvalidInputError) as raised:
        preview_of(index, "1", [below(0.5), Edit("discard", object_ids=(1,))])
    assert raised.value.field == "edits[1].action"


def _rows(gaussians: Gaussians, count: int) -> Gaussians:
    return Gaussians(**{name: getattr(gaussians, name)[:count] for name in FIELDS})
