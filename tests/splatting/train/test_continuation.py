"""A finished scene trained further: it gets no worse, what it is made of is known, and a run continues to the bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fastsplat.service import train_more
from fastsplat.service.capture.formats.kept_capture import kept_capture, kept_lenses
from fastsplat.service.capture.photos.scene_photos import photo_folder, write_photos
from fastsplat.service.capture.settings import PhotoSettings
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.common.progress import ProgressEvent, silent
from fastsplat.service.common.radial_lens import RadialLens
from fastsplat.service.pipeline import Provenance, scene_quality
from fastsplat.service.scene.label_evidence import UNIT, evidence_of
from fastsplat.service.scene.things import rename_thing, thing_rows
from fastsplat.service.scene.types import Scene, Thing, Things
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.continuation import Continued, continuation_settings, continue_training
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.train import train
from fastsplat.service.splatting.types import TrainedSplats
from fastsplat.service.train_more import capture_of, merged_scene, train_further
from fastsplat_contract.errors import (
    CancelledError,
    ConflictError,
    NotReadyError,
    SceneFileError,
    TrainingDivergedError,
)
from tests.splatting.train.conftest import MakeWorld

_SETTINGS = TrainingSettings(
    iterations=120, time_budget_s=None, max_gaussians=500, max_side=64, evaluations=0, held_out_every=4
)


@pytest.fixture
def finished(make_world: MakeWorld, tmp_path: Path) -> tuple[Scene, Path]:
    """A scene whose things are the three labels' Gaussians, and the folder of its version with its photos."""
    capture, labelling = make_world(8)
    trained = train(capture, labelling, _SETTINGS, silent)
    folder = tmp_path / "version"
    folder.mkdir()
    write_photos(capture, folder, PhotoSettings())
    count = len(trained.gaussians)
    owner = 1 + np.arange(count) % 3
    table = tuple(Thing(i, name, "detected", 0.9) for i, name in enumerate(("floor", "ball", "block"), start=1))
    things = Things(table, evidence_of(np.arange(count), owner, np.full(count, UNIT), count))
    dictionary = dictionary_of(["floor", "ball", "block"])
    scene = Scene(
        trained.gaussians,
        trained.head,
        dictionary,
        np.zeros((3, 4), np.float32),
        ("none", "0" * 64),
        tuple(view.posed for view in capture.views),
        "ARBITRARY",
        quality=scene_quality(trained, labelling, capture, Provenance()),
        things=things,
    )
    return scene, folder


def _further(scene: Scene, folder: Path, tmp_path: Path, steps: int, joined: tuple[str, ...] = ()) -> Continued:
    (tmp_path / "masks").mkdir(exist_ok=True)
    capture = capture_of(scene, folder, tmp_path / "masks")
    settings = Settings(data_dir=tmp_path, training=_SETTINGS)
    return train_further(scene, capture, settings, silent, steps=steps, joined=joined)


def test_a_scene_trained_further_is_better_and_has_its_things(finished: tuple[Scene, Path], tmp_path: Path) -> None:
    scene, folder = finished
    continued = _further(scene, folder, tmp_path, 150)
    figures = continued.trained.quality
    assert figures["psnr"] > figures["psnr_before"]
    # The photos are JPEGs now, so that the figure of before is not to the last digit that of the first training.
    assert figures["psnr_before"] == pytest.approx(scene.quality["psnr"], abs=0.5)
    assert set(continued.trained.held_out) == set(scene.quality["held_out_views"])
    renamed = rename_thing(scene, 2, "football")  # somebody did so meanwhile
    merged = merged_scene(renamed, scene, continued)
    assert merged is not None and merged.things is not None and scene.things is not None
    assert [(thing.id, thing.name) for thing in merged.things.table] == [(1, "floor"), (2, "football"), (3, "block")]
    assert np.array_equal(thing_rows(merged.things), thing_rows(scene.things)[continued.origins])
    assert np.array_equal(merged.gaussians.codes, scene.gaussians.codes[continued.origins])
    assert merged.quality["psnr"] == figures["psnr"] and merged.quality["trained_further"] == 1
    assert merged.quality["iterations"] == scene.quality["iterations"] + 150
    # A Gaussian is where the one is that it comes from: the things have not changed places.
    size = float(np.ptp(scene.gaussians.means, axis=0).max())
    moved = np.linalg.norm(merged.gaussians.means - scene.gaussians.means[continued.origins], axis=1)
    assert np.median(moved) < 0.05 * size


def test_what_shows_something_else_is_not_merged(finished: tuple[Scene, Path]) -> None:
    scene, _ = finished
    same = Continued(_train_result(scene), np.arange(len(scene.gaussians)))
    assert merged_scene(scene, scene, same) is not None
    moved = replace(scene.gaussians, means=scene.gaussians.means + np.float32(0.1))
    assert merged_scene(replace(scene, gaussians=moved), scene, same) is None
    recolored = replace(scene.gaussians, sh=scene.gaussians.sh + np.float32(0.1))
    assert merged_scene(replace(scene, gaussians=recolored), scene, same) is None


def test_what_was_not_trained_is_the_current_versions_to_the_bit(finished: tuple[Scene, Path]) -> None:
    scene, _ = finished
    means = scene.gaussians.means
    rounded = np.nextafter(means, np.float32(np.inf))  # as an edit meanwhile, of scale or frame, leaves them
    changed = np.arange(len(means)) % 2 == 0
    current = replace(scene, gaussians=replace(scene.gaussians, means=rounded))
    merged = merged_scene(current, scene, Continued(_train_result(scene), np.arange(len(means)), changed))
    assert merged is not None
    np.testing.assert_array_equal(merged.gaussians.means, np.where(changed[:, None], means, rounded))


def _train_result(scene: Scene) -> TrainedSplats:
    return TrainedSplats(scene.gaussians, scene.head, {"iterations": 0.0, "train_seconds": 0.0}, ())


def test_a_training_that_makes_it_worse_changes_nothing(
    finished: tuple[Scene, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, folder = finished
    for path in photo_folder(folder).glob("*.jpg"):  # trained on other pictures than it is judged by
        if scene.cameras[int(path.stem)].name not in scene.quality["held_out_views"]:
            with Image.open(path) as image:
                Image.new("RGB", image.size, (250, 40, 250)).save(path)
    with pytest.raises(TrainingDivergedError, match="stays as it is"):
        _further(scene, folder, tmp_path, 60)


@pytest.mark.parametrize("photometric", [{}, {"a.png": (0.5, 0.0, 0.0)}], ids=["as they are", "corrected"])
def test_it_is_judged_after_the_correction_of_colors_where_photos_were_corrected(
    finished: tuple[Scene, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, photometric: dict[str, tuple]
) -> None:
    scene, folder = finished
    own, other = ("psnr_cc", "psnr") if photometric else ("psnr", "psnr_cc")

    def ended(change: float, joined: tuple[str, ...] = ()) -> Continued:
        quality = {own: 25.0 + change, f"{own}_before": 25.0, other: 25.0 - change, f"{other}_before": 25.0}
        trained = replace(_train_result(scene), quality=quality, photometric=photometric)
        result = Continued(trained, np.arange(len(scene.gaussians)))
        for name in ("continue_training", "join_photos"):
            monkeypatch.setattr(train_more, name, lambda *_, **__: result)
        return _further(scene, folder, tmp_path, 60, joined)

    assert ended(1.0).trained.quality[own] == 26.0
    for change, joined in ((-0.05, ()), (-0.2, ("b.png",))):
        with pytest.raises(TrainingDivergedError, match="stays as it is"):
            ended(change, joined)
    # Photos that join may show what those that judge do not.
    assert ended(-0.05, ("b.png",)).trained.quality[own] == 24.95


def test_no_setting_takes_from_a_scene_what_it_has(finished: tuple[Scene, Path]) -> None:
    gaussians = finished[0].gaussians
    small = _SETTINGS.model_copy(update={"max_gaussians": 10, "max_sh_degree": 0, "max_psnr_drop_db": 1.0})
    settings = continuation_settings(small, gaussians, seconds=5.0)
    assert settings.max_gaussians == len(gaussians) and settings.max_sh_degree == gaussians.sh_degree == 3
    assert settings.max_psnr_drop_db == 0 and settings.time_budget_s == 5.0
    large = continuation_settings(_SETTINGS.model_copy(update={"max_gaussians": 10**6}), gaussians, steps=10)
    assert large.max_gaussians == 10**6 and (large.iterations, large.time_budget_s) == (10, None)


def test_a_further_training_continues_from_its_checkpoint_to_the_bit(
    finished: tuple[Scene, Path], tmp_path: Path
) -> None:
    scene, folder = finished
    (tmp_path / "masks").mkdir()
    capture = capture_of(scene, folder, tmp_path / "masks")
    settings = continuation_settings(_SETTINGS, scene.gaussians, steps=60).model_copy(
        update={"checkpoint_every_s": 0.0, "evaluations": 6}
    )
    whole = continue_training(scene.gaussians, capture, settings, silent)
    checkpoints = tmp_path / "checkpoints"

    def stop_midway(event: ProgressEvent) -> None:
        if event.metrics.get("iteration", 0) >= 30:
            raise CancelledError("stopped", field="test")

    with pytest.raises(CancelledError):
        continue_training(scene.gaussians, capture, settings, stop_midway, checkpoints)
    resumed = continue_training(scene.gaussians, capture, settings, silent, checkpoints)
    for name, array in vars(whole.trained.gaussians).items():
        assert np.array_equal(array, getattr(resumed.trained.gaussians, name)), name
    assert np.array_equal(whole.origins, resumed.origins)
    other = replace(scene.gaussians, means=scene.gaussians.means + np.float32(0.01))
    with pytest.raises(ConflictError):
        continue_training(other, capture, settings, silent, checkpoints)


def test_masks_points_and_lenses_are_kept_with_the_photos(make_world: MakeWorld, tmp_path: Path) -> None:
    capture, _ = make_world(4)
    mask = np.full((48, 64), 255, np.uint8)
    mask[:, :10] = 0
    Image.fromarray(mask).save(tmp_path / "mask.png")
    lens = RadialLens(0.8, -0.02)
    first = replace(capture.views[0], valid_path=tmp_path / "mask.png")
    masked = replace(capture, views=(first, replace(capture.views[1], lens=lens), *capture.views[2:]))
    folder, scratch = tmp_path / "version", tmp_path / "scratch"
    folder.mkdir()
    scratch.mkdir()
    write_photos(masked, folder, PhotoSettings())
    cameras = tuple(view.posed for view in capture.views)
    again = kept_capture(photo_folder(folder), cameras, "ARBITRARY", ("001.png",), scratch)
    assert np.array_equal(again.points, capture.points) and again.test_names == ("001.png",)
    assert [view.valid_path is not None for view in again.views] == [True, False, False, False]
    assert again.views[0].valid_path is not None
    with Image.open(again.views[0].valid_path) as image:
        assert np.array_equal(np.asarray(image) == 255, mask == 255)
    assert [view.posed for view in again.views] == list(cameras)
    assert [view.lens for view in again.views] == [None, lens, None, None]
    assert kept_lenses(photo_folder(folder)) == (lens,)


@pytest.mark.parametrize(
    "damage",
    [
        lambda whole: b"",
        lambda whole: b"no archive",
        lambda whole: whole[: len(whole) // 2],
        lambda whole: whole[:100] + bytes(40) + whole[140:],
    ],
)
def test_a_damaged_file_of_points_and_lenses_is_said_to_be(
    make_world: MakeWorld, tmp_path: Path, damage: Callable[[bytes], bytes]
) -> None:
    capture, _ = make_world(2)
    write_photos(capture, tmp_path, PhotoSettings())
    photos = photo_folder(tmp_path)
    path = photos / "points.npz"
    path.write_bytes(damage(path.read_bytes()))
    cameras = tuple(view.posed for view in capture.views)
    for read in (lambda: kept_lenses(photos), lambda: kept_capture(photos, cameras, "ARBITRARY", (), tmp_path)):
        with pytest.raises(SceneFileError) as caught:
            read()
        assert caught.value.field == "points.npz"


def test_older_scenes_have_their_empty_borders_seen(make_world: MakeWorld, tmp_path: Path) -> None:
    folder, scratch = tmp_path / "photos", tmp_path / "scratch"
    folder.mkdir()
    scratch.mkdir()
    picture = np.full((48, 64, 3), 120, np.uint8)
    picture[:, :8] = 0  # as undistortion leaves it
    picture[20:30, 30:40] = 0  # a black thing
    Image.fromarray(picture).save(folder / "00000.jpg", quality=90)
    capture, _ = make_world(1)
    again = kept_capture(folder, (capture.views[0].posed,), "ARBITRARY", (), scratch)
    assert again.views[0].valid_path is not None and not len(again.points)
    assert kept_lenses(folder) == ()
    with Image.open(again.views[0].valid_path) as image:
        valid = np.asarray(image) == 255
    assert not valid[:, :8].any() and valid[:, 16:].all()


def test_a_scene_without_photos_is_not_trained_further(finished: tuple[Scene, Path], tmp_path: Path) -> None:
    scene, _ = finished
    with pytest.raises(NotReadyError):
        capture_of(scene, tmp_path, tmp_path)
