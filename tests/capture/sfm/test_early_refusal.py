"""Photos of which no scene can be made are refused by their matches, before anything tries to place them."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.sfm import reconstruction
from fastsplat.service.capture.sfm.early_refusal import refuse_hopeless, shows_depth
from fastsplat.service.capture.sfm.model_agreement import verified_matches
from fastsplat.service.capture.sfm.pairs import telling_pairs
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import ProgressEvent
from fastsplat_contract.errors import ReconstructionError
from tests.capture import made_room
from tests.capture.synthetic_views import synthesize_views

_WIDTH, _HEIGHT = 1000, 750


def _matches(seed: int, focal: float, baseline: float, flat: bool) -> tuple[np.ndarray, np.ndarray]:
    """Points at depths 2 to 6, or on a slanted wall, in two photos `baseline` apart, with 0.7 px of noise."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform([0, 0], [_WIDTH, _HEIGHT], (300, 2))
    rays = np.column_stack([(pixels - [_WIDTH / 2, _HEIGHT / 2]) / (focal * _WIDTH), np.ones(300)])
    depths = 3 / (1 + 0.8 * rays[:, 0]) if flat else rng.uniform(2, 6, 300)
    axis = rng.normal(size=3)
    angle = np.radians(rng.uniform(3, 20))
    turn = pycolmap.Rotation3d(angle * axis / np.linalg.norm(axis)).matrix()
    step = np.array([1.0, rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3)])
    there = (rays * depths[:, None] - baseline * step / np.linalg.norm(step)) @ turn.T
    seen = there[:, :2] / there[:, 2:] * focal * _WIDTH + [_WIDTH / 2, _HEIGHT / 2]
    inside = (seen >= 0).all(axis=1) & (seen < [_WIDTH, _HEIGHT]).all(axis=1)
    assert inside.sum() > 50
    return tuple(part[inside] + rng.normal(0, 0.7, part[inside].shape) for part in (pixels, seen))


def _camera(focal: float, *, known: bool) -> pycolmap.Camera:
    guess = focal if known else 1.2
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", guess * _WIDTH, _WIDTH, _HEIGHT)
    camera.has_prior_focal_length = known
    return camera


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("focal", [0.6, 0.87, 1.5])
@pytest.mark.parametrize("seed", range(3))
def test_only_photos_from_different_places_show_depth(seed: int, focal: float, known: bool) -> None:
    camera = _camera(focal, known=known)
    for flat in (False, True):
        assert not shows_depth(camera, camera, *_matches(seed, focal, 0.0, flat))
        assert shows_depth(camera, camera, *_matches(seed, focal, 0.5, flat))
    assert shows_depth(camera, camera, *_matches(seed, focal, 0.25, flat=False))


def _keep(database: Path, pairs: set[tuple[int, int]]) -> None:
    with pycolmap.Database.open(database) as editor:
        for pair in verified_matches(database).keys() - pairs:
            editor.delete_two_view_geometry(*pair)


def test_what_could_be_placed_is_never_refused(tmp_path: Path) -> None:
    database = tmp_path / "features.db"
    synthesize_views(database, 10, 60)
    for complete in (False, True):
        refuse_hopeless(database, min_share=0.2, complete=complete)
    _keep(database, {(1, 2), (2, 3)})
    for complete in (False, True):
        refuse_hopeless(database, min_share=0.3, complete=complete)


def test_photos_that_share_nothing_or_too_little_are_refused_once_all_pairs_are_matched(tmp_path: Path) -> None:
    database = tmp_path / "features.db"
    synthesize_views(database, 10, 60)
    for pairs, share, text in (
        ({(1, 2), (4, 5), (5, 6), (9, 10)}, 0.5, "no more than 3 of 10"),
        (set[tuple[int, int]](), 0.2, "no two of the 10 photos"),
    ):
        _keep(database, pairs)
        refuse_hopeless(database, min_share=share, complete=False)
        with pytest.raises(ReconstructionError, match=text) as caught:
            refuse_hopeless(database, min_share=share, complete=True)
        assert "10 photos are few" in caught.value.hint and "20 to 40" in caught.value.hint


@pytest.mark.parametrize("count", [2, 5, 26, 60])
def test_telling_pairs_are_few_and_link_all_photos(count: int) -> None:
    telling = telling_pairs(count)
    assert telling == sorted(set(telling)) and len(telling) <= count + 14
    assert {image for pair in telling for image in pair} == set(range(count))
    assert all(0 <= i < j < count for i, j in telling)


def _refusal(folder: Path, settings) -> tuple[ReconstructionError, str]:
    """The refusal, and the messages before it."""
    lighter = settings.model_copy(update={"max_side": 400, "sfm_features": 1_500})
    validate_upload(folder, lighter)
    events: list[ProgressEvent] = []
    with pytest.raises(ReconstructionError) as caught:
        build_capture(folder, folder.parent / "out", lighter, events.append)
    return caught.value, " ".join(event.message for event in events)


def test_photos_that_only_turn_in_place_are_refused_before_any_is_placed(tmp_path: Path, settings) -> None:
    (tmp_path / "upload").mkdir()
    x, y = np.meshgrid((np.arange(400) - 200) / 320, (np.arange(300) - 150) / 320)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    for number in range(8):
        pixels = made_room.photo(made_room.pose((0.2, -0.3, 1.4), 7.0 * number), rays)
        Image.fromarray(pixels).save(tmp_path / f"upload/{number}.png")
    error, messages = _refusal(tmp_path / "upload", settings)
    assert "from one place" in error.message and "to the side" in error.hint and "8 photos are few" in error.hint
    assert "registering" not in messages


def test_of_many_pairs_those_that_tell_most_are_matched_first_and_refuse(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    matched: list[list[tuple[str, str]]] = []
    looked: list[bool] = []
    files = [f"{number}.png" for number in range(10)]
    request = {"sfm_max_side": 400, "sfm_features": 10, "sfm_threads": 1, "min_registered_share": 0.2}
    every = [(i, j) for i in range(10) for j in range(i + 1, 10)]
    monkeypatch.setattr(reconstruction, "_PAIRS_A_STEP", 24)
    monkeypatch.setattr(reconstruction, "extract_features", lambda *_: None)
    monkeypatch.setattr(reconstruction, "_choose_pairs", lambda *_: every)
    monkeypatch.setattr(reconstruction, "_match", lambda _, names, *__: matched.append(names))
    monkeypatch.setattr(reconstruction, "refuse_hopeless", lambda _, *, min_share, complete: looked.append(complete))
    for early in (True, False):
        matched.clear(), looked.clear()
        reconstruction.extract_and_match(
            tmp_path, tmp_path, files, request, tmp_path, lambda fraction, message: None, alone=early
        )
        assert sorted(pair for step in matched for pair in step) == sorted((files[i], files[j]) for i, j in every)
        assert looked == [False] * early
        best_pairs = {(files[i], files[j]) for i, j in telling_pairs(10)}
        assert (best_pairs <= set(matched[0])) == early


def test_photos_of_unrelated_places_are_refused_before_any_is_placed(test_data: Path, tmp_path: Path, settings) -> None:
    (tmp_path / "upload").mkdir()
    for place in ("kitchen", "plush", "skull", "tabletop"):
        source = sorted((test_data / place / "images").iterdir())[5]
        shutil.copy(source, tmp_path / f"upload/{place}{source.suffix}")
    error, messages = _refusal(tmp_path / "upload", settings)
    assert "no two of the 4 photos show the same object" in error.message and "20 to 40" in error.hint
    assert "registering" not in messages
