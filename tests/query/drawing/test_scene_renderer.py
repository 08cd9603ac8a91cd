"""Masks in images: they hold the Gaussians that the 3D mask holds, nothing where nothing is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.errors import LimitExceededError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.query.conftest import PLAIN, DrawnEncoder, make_scene

LEANING = {"mug": [1.0], "cup": [0.8, 0.6], "spoon": [0.7, -0.1, 0.7], "bed": [0, 0, 0, 1.0]}


@pytest.fixture
def index() -> SceneIndex:
    return SceneIndex(make_scene(), DrawnEncoder(LEANING), PLAIN)


def pixel_of(index: SceneIndex, row: int, posed: PosedCamera) -> tuple[int, int]:
    x, y = posed.pixels(index.scene.gaussians.means[row])
    return int(y), int(x)


@pytest.mark.parametrize("label", ["mug", "spoon", "bed"])
def test_a_mask_covers_its_own_gaussian_and_no_other(index: SceneIndex, front: PosedCamera, label: str) -> None:
    (answer,) = index.ask([label])
    mask = index.mask2d(answer, front).mask
    chosen = index.mask3d(answer)
    assert mask.shape == (48, 64) and mask.dtype == np.bool_ and mask.any()
    for row in range(len(chosen)):
        assert mask[pixel_of(index, row, front)] == chosen[row]


def test_the_label_map_is_the_union_of_the_masks(index: SceneIndex, front: PosedCamera) -> None:
    label_map = index.label_map(front)
    for label_id, label in enumerate(["mug", "spoon", "bed"], start=1):
        (answer,) = index.ask([label])
        np.testing.assert_array_equal(index.mask2d(answer, front).mask, label_map == label_id)


def test_a_mask_of_more_entries_is_the_union(index: SceneIndex, front: PosedCamera) -> None:
    cup, mug, spoon = index.ask(["cup", "mug", "spoon"])
    assert cup.relation == "related" and set(cup.relevant_ids) == {1, 2}
    both = index.mask2d(mug, front).mask | index.mask2d(spoon, front).mask
    np.testing.assert_array_equal(index.mask2d(cup, front).mask, both)
    np.testing.assert_array_equal(index.mask3d(cup), index.mask3d(mug) | index.mask3d(spoon))


def test_relevancy_is_the_expected_relevancy(index: SceneIndex, front: PosedCamera) -> None:
    (answer,) = index.ask(["cup"])
    seen = index.mask2d(answer, front)
    assert seen.relevancy.dtype == np.float32 and seen.relevancy.min() >= 0 and seen.relevancy.max() <= 1
    by_id = {match.label_id: match.relevancy for match in answer.matches}
    for row in (1, 2, 3):
        # The ball is opaque to alpha_max = 0.99 at most, and its head is sure to within a thousandth.
        assert seen.relevancy[pixel_of(index, row, front)] == pytest.approx(by_id[row], rel=0.05)
    assert seen.relevancy[0, 0] == 0
    assert seen.relevancy[pixel_of(index, 0, front)] < 0.05 * max(by_id.values())


def test_a_pose_that_sees_nothing(index: SceneIndex, away: PosedCamera) -> None:
    for answer in index.ask(["mug", "cup"]):
        seen = index.mask2d(answer, away)
        assert not seen.mask.any() and not seen.relevancy.any() and not seen.rgb.any()
    assert not index.depth(away).any() and not index.label_map(away).any()


def test_the_picture_is_the_render(index: SceneIndex, front: PosedCamera) -> None:
    (answer,) = index.ask(["mug"])
    rgb = index.render(front)
    assert rgb.shape == (48, 64, 3) and rgb.dtype == np.uint8 and rgb.any()
    np.testing.assert_array_equal(index.mask2d(answer, front).rgb, rgb)


def test_depth_is_the_distance_along_the_view(index: SceneIndex, front: PosedCamera) -> None:
    depth = index.depth(front)
    assert depth.dtype == np.float32
    for row, mean in enumerate(index.scene.gaussians.means):
        assert depth[pixel_of(index, row, front)] == pytest.approx(mean[2] + 4.0, abs=1e-3)
    assert depth[0, 0] == 0


def test_a_higher_alpha_only_removes_pixels(front: PosedCamera) -> None:
    before: np.ndarray | None = None
    for alpha in (0.1, 0.5, 0.9, 1.0):
        index = SceneIndex(make_scene(), DrawnEncoder(LEANING), PLAIN.model_copy(update={"alpha_min": alpha}))
        mask = index.mask2d(index.ask(["mug"])[0], front).mask
        assert before is None or not (mask & ~before).any()
        before = mask
    assert before is not None and not before.any()


def test_no_gaussians_at_all(front: PosedCamera) -> None:
    scene = make_scene()
    none = {name: getattr(scene.gaussians, name)[:0] for name in scene.gaussians.__dataclass_fields__}
    index = SceneIndex(replace(scene, gaussians=replace(scene.gaussians, **none)), DrawnEncoder(LEANING), PLAIN)
    (answer,) = index.ask(["mug"])
    assert index.mask3d(answer).shape == (0,) and not index.mask2d(answer, front).mask.any()


def test_size_is_bounded(index: SceneIndex) -> None:
    posed = PosedCamera(Camera(4097, 1, 50, 50, 1, 1), np.eye(4))
    (answer,) = index.ask(["mug"])
    for use in (index.render, index.depth, index.label_map, lambda p: index.mask2d(answer, p)):
        with pytest.raises(LimitExceededError, match="4097"):
            use(posed)


def test_asking_renders_nothing(index: SceneIndex) -> None:
    mug, *_ = index.ask(["mug", "cup", "cloud"])
    assert index.mask3d(mug).any() and index.objects_of(mug)
    assert index._renderer is None
