"""Labels on an imported splat: nothing but the labels changes, and they fit the user's own rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.common.progress import ProgressEvent, silent
from fastsplat.service.perception.results import Labelling
from fastsplat.service.splat_import.label_lifting import lift_labels
from fastsplat.service.splat_import.splat_import_settings import SplatImportSettings
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat_contract.errors import CancelledError, InvalidInputError
from tests.instances.made_room import NAMES, Room, make_room

_FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")
_TRAINING = TrainingSettings()
_SETTINGS = SplatImportSettings(code_steps=40)


def with_splat(room: Room, folder: Path, order: np.ndarray | None = None) -> Capture:
    """The room's capture with its splat beside the photos, rows in this order."""
    rows = np.arange(len(room.gaussians)) if order is None else order
    path = folder / "splat.safetensors"
    save_file({name: np.ascontiguousarray(getattr(room.gaussians, name)[rows]) for name in _FIELDS}, path)
    return replace(room.capture, splat=path)


def labelling_of(room: Room) -> Labelling:
    return Labelling(dictionary_of(NAMES), room.maps, exact=True)


def classes_of(trained: TrainedSplats) -> np.ndarray:
    """The label of each Gaussian, 0 for none."""
    if trained.evidence is None:
        logits: np.ndarray = trained.gaussians.codes @ trained.head.weight.T + trained.head.bias
        return logits.argmax(axis=1)
    dense = np.zeros((len(trained.evidence), len(NAMES) + 1))
    rows = np.repeat(np.arange(len(trained.evidence)), np.diff(trained.evidence.starts))
    dense[rows, trained.evidence.labels] = trained.evidence.counts
    return dense.argmax(axis=1)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Room:
    return make_room(tmp_path_factory.mktemp("room"), views=6)


@pytest.mark.parametrize("mode", ["auto", "evidence"])
def test_only_labels_are_added_and_they_are_the_true_ones(room: Room, tmp_path: Path, mode: str) -> None:
    training = _TRAINING.model_copy(update={"label_mode": mode})
    capture = with_splat(room, tmp_path)
    heard: list[ProgressEvent] = []
    trained = lift_labels(capture, labelling_of(room), training, _SETTINGS, heard.append)
    for name in _FIELDS:
        np.testing.assert_array_equal(getattr(trained.gaussians, name), getattr(room.gaussians, name))
    assert (trained.evidence is None) == (mode == "auto") and trained.held_out == ()
    classes = classes_of(trained)
    for obj in range(1, len(NAMES)):
        mask = room.owner == obj
        assert (classes[mask] == obj + 1).sum() > 0.9 * (classes[mask] > 0).sum() > 0
        assert (room.owner[classes == obj + 1] == obj).mean() > 0.95
    assert trained.quality["psnr"] > 25 and trained.quality["gaussians"] == len(room.gaussians)
    fractions = [event.fraction for event in heard]
    assert fractions == sorted(fractions) and fractions[-1] == 1


@pytest.mark.parametrize("mode", ["auto", "evidence"])
def test_rows_in_another_order_get_the_same_labels(room: Room, tmp_path: Path, mode: str) -> None:
    training = _TRAINING.model_copy(update={"label_mode": mode})
    still = SplatImportSettings(code_steps=0)
    order = np.random.default_rng(0).permutation(len(room.gaussians))
    plain = lift_labels(with_splat(room, tmp_path), labelling_of(room), training, still, silent)
    turned = lift_labels(with_splat(room, tmp_path, order), labelling_of(room), training, still, silent)
    np.testing.assert_array_equal(turned.gaussians.means, plain.gaussians.means[order])
    assert (classes_of(turned) == classes_of(plain)[order]).mean() > 0.999


def test_steps_sharpen_what_pixels_show(room: Room, tmp_path: Path) -> None:
    losses: list[float] = []

    def listen(event: ProgressEvent) -> None:
        losses.extend([event.metrics["loss"]] if "loss" in event.metrics else [])

    lift_labels(with_splat(room, tmp_path), labelling_of(room), _TRAINING, _SETTINGS, listen)
    assert len(losses) == 40 and np.mean(losses[-6:]) < 0.95 * np.mean(losses[:6])


def test_a_splat_without_labels_is_a_scene_without_labels(room: Room, tmp_path: Path) -> None:
    capture = with_splat(room, tmp_path)
    trained = lift_labels(capture, Labelling(dictionary_of(()), ()), _TRAINING, _SETTINGS, silent)
    assert trained.gaussians.codes.shape[1] == 0 and trained.head.weight.shape == (1, 0) and trained.evidence is None


def test_label_maps_that_name_nothing_leave_every_gaussian_undetected(room: Room, tmp_path: Path) -> None:
    blank = Labelling(dictionary_of(NAMES), tuple(np.zeros_like(label_map) for label_map in room.maps))
    trained = lift_labels(with_splat(room, tmp_path), blank, _TRAINING, _SETTINGS, silent)
    assert (classes_of(trained) == 0).all()


def test_photos_of_another_world_are_refused(room: Room, tmp_path: Path) -> None:
    capture = with_splat(room, tmp_path)
    views = []
    for view in capture.views:
        pose = view.posed.world_from_camera.copy()
        pose[:3, 3] += (4.0, -3.0, 2.0)
        views.append(replace(view, posed=replace(view.posed, world_from_camera=pose)))
    with pytest.raises(InvalidInputError, match="do not show the splat") as caught:
        lift_labels(replace(capture, views=tuple(views)), labelling_of(room), _TRAINING, _SETTINGS, silent)
    assert caught.value.field == "poses" and "dataparser_transforms" in caught.value.hint


def test_a_cancelled_lifting_ends_at_once(room: Room, tmp_path: Path) -> None:
    steps = []

    def cancel(event: ProgressEvent) -> None:
        steps.append(event.message)
        if "step 3" in event.message:
            raise CancelledError("enough")

    with pytest.raises(CancelledError):
        lift_labels(with_splat(room, tmp_path), labelling_of(room), _TRAINING, _SETTINGS, cancel)
    assert sum("step" in step for step in steps) == 3
