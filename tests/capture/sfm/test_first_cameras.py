"""The first images get cameras before the others have features, and nothing else depends on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from fastsplat.service.capture.sfm import reconstruction
from fastsplat.service.capture.sfm.mapping_snapshots import take_placed
from fastsplat.service.capture.sfm.pairs import choose_pairs
from fastsplat.service.capture.sfm.reconstruction import FIRST_IMAGES, first_pairs, place_first
from tests.capture.synthetic_views import synthesize_views

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
