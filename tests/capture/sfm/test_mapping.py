"""How images get cameras: the first before others have features; and where thresholds or a wrong pair mislead."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray

from fastsplat.service.capture.sfm import model_agreement, reconstruction
from fastsplat.service.capture.sfm.mapping import (
    Mapping,
    Models,
    contradicting_pairs,
    mapper_options,
    strongest_pairs,
    take_out_impossible,
)
from fastsplat.service.capture.sfm.mapping_snapshots import take_placed
from fastsplat.service.capture.sfm.model_agreement import (
    VerifiedMatches,
    choose_held_out,
    give_back,
    verified_matches,
    withhold,
)
from fastsplat.service.capture.sfm.pairs import choose_pairs
from fastsplat.service.capture.sfm.reconstruction import FIRST_IMAGES, first_pairs, place_first
from fastsplat.service.common.similarity import fit_similarity
from tests.capture.synthetic_views import synthesize_views

_ALL_AT_ONCE, _ONE_BY_ONE = 2, 1_000


def _mapping(folder: Path) -> Mapping:
    with pycolmap.Database.open(folder / "features.db") as reader:
        names = [image.name for image in reader.read_all_images()]
    images = [{"file": name} for name in names]
    return Mapping(folder / "features.db", folder, folder, images, lambda *_: None, lambda *_: None)


def _thin(database: Path, stays: Callable[[int, int, np.ndarray], np.ndarray]) -> None:
    with pycolmap.Database.open(database) as editor:
        for pair, rows in verified_matches(database).items():
            changed = editor.read_two_view_geometry(*pair)
            changed.inlier_matches = stays(*pair, rows)
            editor.update_two_view_geometry(*pair, changed)


def _largest_error(models: Models, truth: pycolmap.Reconstruction) -> float:
    """Of a center, as a share of how far the true ones are spread, after the best similarity."""
    placed = {image.name: image.projection_center() for image in models[0].images.values() if image.has_pose}
    true = {image.name: image.projection_center() for image in truth.images.values() if image.name in placed}
    a, b = (np.array([some[name] for name in sorted(true)]) for some in (placed, true))
    return float(np.linalg.norm(fit_similarity(a, b).points(a) - b, axis=1).max() / np.linalg.norm(np.ptp(b, axis=0)))


def test_an_image_with_few_matches_is_placed_where_the_first_mapping_leaves_it_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = synthesize_views(tmp_path / "features.db", 8)
    # The last image shares 22 points with one other, fewer than the 30 that COLMAP asks for.
    _thin(tmp_path / "features.db", lambda first, second, rows: rows if second < 8 else rows[: 22 * (first == 1)])
    database, models = tmp_path / "features.db", tmp_path / "usual"
    models.mkdir()
    usual = pycolmap.incremental_mapping(database, tmp_path, models, options=mapper_options())
    assert max(model.num_reg_images() for model in usual.values()) == 7
    reads: list[Path] = []
    monkeypatch.setattr(model_agreement, "verified_matches", lambda path: reads.append(path) or verified_matches(path))
    mapped = _mapping(tmp_path).run(_ONE_BY_ONE)
    assert mapped.models[0].num_reg_images() == 8 and mapped.contradictions == (0, 7 * 6 // 2)
    assert reads == [tmp_path / "features.db"]  # once, however many models were compared
    assert _largest_error(mapped.models, truth) < 0.01


def test_copies_of_a_photo_do_not_take_the_matching_that_would_join_it() -> None:
    """Of the images 3 to 7, which are left, 3 has most matches with its copies."""
    matches = {pair: np.zeros((200, 2), np.uint32) for pair in ((3, 4), (3, 5), (3, 6), (3, 7), (4, 5), (6, 7))}
    matches |= {(1, 3): np.zeros((20, 2), np.uint32), (2, 7): np.zeros((30, 2), np.uint32)}
    chosen = strongest_pairs(matches, {}, {3, 4, 5, 6, 7})
    assert {(1, 3), (2, 7)} <= set(chosen)


def test_where_all_are_placed_nothing_more_is_tried(tmp_path: Path) -> None:
    synthesize_views(tmp_path / "features.db", 6)
    models = _mapping(tmp_path).run(_ONE_BY_ONE).models
    assert models[0].num_reg_images() == 6
    assert not (tmp_path / "again.db").exists() and not (tmp_path / "global").exists()


def test_all_at_once_is_as_right_as_one_by_one_and_the_same_again(tmp_path: Path) -> None:
    poses = []
    for name in ("first", "second"):
        folder = tmp_path / name
        folder.mkdir()
        truth = synthesize_views(folder / "features.db", 10)
        models = _mapping(folder).run(_ALL_AT_ONCE).models
        assert not (folder / "models").exists()  # one by one was not needed
        assert models[0].num_reg_images() == 10 and _largest_error(models, truth) < 0.01
        poses.append({image.name: image.cam_from_world().matrix() for image in models[0].images.values()})
    assert all(np.array_equal(poses[0][name], poses[1][name]) for name in poses[0])


@pytest.mark.parametrize("global_images", [_ALL_AT_ONCE, _ONE_BY_ONE])
def test_photos_that_share_nothing_give_no_model(tmp_path: Path, global_images: int) -> None:
    synthesize_views(tmp_path / "features.db", 4)
    _thin(tmp_path / "features.db", lambda first, second, rows: rows[:0])
    assert _mapping(tmp_path).run(global_images).models == []


def test_held_out_matches_tell_a_wrong_pose(tmp_path: Path) -> None:
    database = tmp_path / "features.db"
    truth = synthesize_views(database, 6)
    before = verified_matches(database)
    held_out = choose_held_out(before, 60)
    withhold(database, held_out)
    after = verified_matches(database)
    assert all(len(after[pair]) + len(held_out[pair]) == len(before[pair]) for pair in held_out)
    total = sum(len(rows) for rows in held_out.values())
    assert VerifiedMatches(database).explained(truth, held_out) == total > 50
    give_back(database, held_out)
    again = verified_matches(database)
    assert again.keys() == before.keys() and all(len(again[pair]) == len(before[pair]) for pair in before)
    frame = truth.images[1].frame
    assert frame is not None and frame.rig_from_world is not None
    shifted = np.array(frame.rig_from_world.matrix())
    shifted[:, 3] += [0.5, 0.3, 0.0]
    frame.rig_from_world = pycolmap.Rigid3d(shifted)
    of_others = sum(len(rows) for pair, rows in held_out.items() if 1 not in pair)
    assert of_others <= VerifiedMatches(database).explained(truth, held_out) < total - 10


_TILE = 10
_SEEN = 40


def _walk(
    wrong: set[tuple[int, int]],
) -> tuple[dict[tuple[int, int], NDArray[np.uint32]], dict[int, NDArray[np.float32]]]:
    """Six images of a long wall, each four features further on; the wrong pairs match one tile further on."""
    pixels = {i: np.stack([20.0 * np.arange(_SEEN), np.zeros(_SEEN)], axis=1).astype(np.float32) for i in range(6)}
    matches = {}
    for i in range(6):
        for j in range(i + 1, 6):
            rows = np.arange(_SEEN)
            there = rows - 4 * (j - i) + (_TILE if (i, j) in wrong else 0)
            visible = (there >= 0) & (there < _SEEN)
            matches[i, j] = np.stack([rows[visible], there[visible]], axis=1).astype(np.uint32)
    return matches, pixels


@pytest.mark.parametrize("wrong", [set(), {(0, 3)}, {(0, 4), (1, 5)}, {(0, 5), (2, 4)}])
def test_exactly_the_pairs_that_are_off_by_a_tile_are_told(wrong: set[tuple[int, int]]) -> None:
    matches, pixels = _walk(wrong)
    assert set(contradicting_pairs(matches, pixels)) == wrong


def test_a_feature_with_two_orientations_is_no_contradiction() -> None:
    matches, pixels = _walk(set())
    pixels = {image: np.repeat(places[::2], 2, axis=0) for image, places in pixels.items()}
    matches[0, 3] = matches[0, 3] ^ np.array([0, 1], np.uint32)  # the twin of each feature of the second image
    assert contradicting_pairs(matches, pixels) == []


def _runaway(image: pycolmap.Image) -> None:
    camera = image.camera
    camera.width, camera.height = 219, 463
    camera.params = np.array([365.67, 109.5, 231.5, -0.5187])  # as bundle adjustment left it once


def _lens_of(*params: float) -> Callable[[pycolmap.Image], None]:
    def change(image: pycolmap.Image) -> None:
        image.camera.params = np.array(params)

    return change


def _lost(image: pycolmap.Image) -> None:
    pose = np.array(image.frame.rig_from_world.matrix())
    pose[1, 3] = np.nan
    image.frame.rig_from_world = pycolmap.Rigid3d(pose)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (_runaway, "lens"),
        (_lens_of(90_000.0, 512, 384, 0.0), "lens"),
        (_lens_of(90.0, 512, 384, 0.0), "lens"),
        (_lens_of(np.nan, 512, 384, 0.0), "lens"),
        (_lens_of(1280.0, 512, 384, np.inf), "lens"),
        (_lens_of(1280.0, -9e9, 384, 0.0), "lens"),
        (_lost, "unknown"),
    ],
)
def test_an_impossible_camera_leaves_with_its_observations_and_no_other(tmp_path: Path, spoil, reason: str) -> None:
    model = synthesize_views(tmp_path / "features.db", 8, 60, cameras=8)
    spoiled = model.images[3]
    before = {image.name: image.cam_from_world().matrix() for image in model.images.values()}
    spoil(spoiled)
    assert take_out_impossible([model], 1600) == {spoiled.name: reason}
    after = {image.name: image.cam_from_world().matrix() for image in model.images.values() if image.has_pose}
    assert after.keys() == before.keys() - {spoiled.name}
    assert all(np.array_equal(after[name], before[name]) for name in after)
    seen_by = {element.image_id for point in model.points3D.values() for element in point.track.elements}
    assert model.num_points3D() > 50 and spoiled.image_id not in seen_by
    assert all(point.track.length() >= 2 for point in model.points3D.values())
    assert take_out_impossible([model], 1600) == {}


_REQUEST = {"sfm_max_side": 400, "sfm_features": 10, "sfm_threads": 1, "min_registered_share": 0.2}


def _features(database: Path) -> dict[str, str]:
    """The names of as many images as are looked at first."""
    truth = synthesize_views(database, FIRST_IMAGES)
    return {image.name: f"{image.name}.jpg" for image in truth.images.values()}


def test_the_first_images_get_cameras_by_the_matches_so_far(tmp_path: Path) -> None:
    names = _features(tmp_path / "features.db")
    assert place_first(tmp_path / "features.db", tmp_path, tmp_path)
    placed = take_placed(tmp_path, names, 30)
    assert placed is not None and not placed.complete
    assert (placed.placed, placed.images) == (FIRST_IMAGES, 30)
    assert {camera.name for camera in placed.cameras} == set(names.values()) and len(placed.points) > 100


def test_images_without_matches_leave_nothing(tmp_path: Path) -> None:
    names = _features(tmp_path / "features.db")
    with pycolmap.Database.open(tmp_path / "features.db") as editor:
        editor.clear_two_view_geometries()
    assert not place_first(tmp_path / "features.db", tmp_path, tmp_path)
    assert take_placed(tmp_path, names, 30) is None


@pytest.mark.parametrize("images", [2 * FIRST_IMAGES - 1, 2 * FIRST_IMAGES])
@pytest.mark.parametrize("alone", [False, True])
def test_they_are_placed_once_their_own_features_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, images: int, alone: bool
) -> None:
    files, done = [f"{number}.png" for number in range(images)], list[str]()
    every = [(i, j) for i in range(images) for j in range(i + 1, images)]
    monkeypatch.setattr(reconstruction, "extract_features", lambda *_: done.append("features"))
    monkeypatch.setattr(reconstruction, "_match", lambda _, names, *__: done.append(f"match {len(names)}"))
    monkeypatch.setattr(reconstruction, "place_first", lambda *_: bool(done.append("place")) or True)
    monkeypatch.setattr(reconstruction, "_choose_pairs", lambda *_: every)
    heard: list[str] = []
    reconstruction.extract_and_match(
        tmp_path, tmp_path, files, _REQUEST, tmp_path, lambda _, message: heard.append(message), alone=alone
    )
    first = ["features", f"match {len(first_pairs())}", "place"] if alone and images >= 2 * FIRST_IMAGES else []
    assert done == [*first, *["features"] * (2 - bool(first)), f"match {len(every)}"]
    assert ("the first images have cameras" in heard) == bool(first)


@pytest.mark.parametrize("exhaustive", [0, 100])
def test_their_pairs_are_matched_in_any_capture(exhaustive: int) -> None:
    chosen = choose_pairs(np.zeros((30, 30), np.int32), exhaustive_images=exhaustive, pairs_per_image=3, ordered=False)
    assert set(first_pairs()) <= set(chosen)
