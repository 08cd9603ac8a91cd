"""Small scenes of training views, with photos held out whose poses are known; kept on disk between runs."""

from __future__ import annotations

import os
import pickle
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.evaluation.datasets.training import subset, training_capture
from benchmarks.evaluation.validation_split import Split, validation_names
from benchmarks.provenance import ROOT
from fastsplat.service.capture.capture_settings import PhotoSettings
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.photos.scene_photos import write_photos
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import silent
from fastsplat.service.jobs.create_scene import build_scene, capture_folder
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.settings import Settings
from fastsplat_contract.geometry.camera import PosedCamera

POSED = ("sample", "tabletop")
UNPOSED = "plush"
_EVERY = 6
"""Of photos without a split, every sixth is a test photo."""


@dataclass(frozen=True)
class HeldOut:
    """A photo that the scene has not seen.

    Attributes:
        name: of its file.
        path: of the photo as it was taken.
        posed: its camera in the scene's frame: of `POSED` the true one, of plush that of structure from motion over all
            photos together, which is no truth but the frame that the scene was trained in.
    """

    name: str
    path: Path
    posed: PosedCamera


@dataclass(frozen=True)
class TrainedPlace:
    """A trained scene.

    Attributes:
        scene: its cameras are the training views alone.
        folder: with the kept copies of their photos, as the service keeps them with a version.
        held_out: what is to be localized.
    """

    scene: Scene
    folder: Path
    held_out: tuple[HeldOut, ...]


def trained_place(name: str, split: Split, settings: Settings, cache: Path) -> TrainedPlace:
    """A scene of a data set, trained on its training views; of these, `validation` sets some
    apart.

    Args:
        name: of `POSED`, or `UNPOSED`.
        split: what is held out.
        settings: with bounds on the training.
        cache: folder in which it is found again.
    """
    folder = cache / f"{name}-{split}"
    mark = folder / "held_out.pickle"  # written by ourselves, last
    if not mark.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        capture, held_out = _captured(name, split, settings, cache, folder)
        built = build_scene(capture, settings, labelling=Labelling(Dictionary(()), ()))
        write_scene(built.scene, folder / "artefact")
        write_photos(capture, folder, PhotoSettings())
        mark.write_bytes(pickle.dumps(held_out))
    held: tuple[HeldOut, ...] = pickle.loads(mark.read_bytes())
    return TrainedPlace(read_scene(folder / "artefact"), folder, held)


def other_photos(names: Sequence[str], count: int, *, odd: bool) -> list[Path]:
    """At most `count` photos of these data sets, evenly from each, only those with an odd number or an even one."""
    found = []
    for name in names:
        every = sorted(path for path in (_folder(name) / "images").iterdir() if path.is_file())
        half = every[odd::2]
        quota = -(-count // len(names))
        found += [
            half[row] for row in np.unique(np.linspace(0, len(half) - 1, min(quota, len(half))).round().astype(int))
        ]
    return found[:count]


def _folder(name: str) -> Path:
    return ROOT / "demo" / "sample" if name == "sample" else Path(os.environ["FASTSPLAT_TEST_DATA"]) / name


def _captured(
    name: str, split: Split, settings: Settings, cache: Path, folder: Path
) -> tuple[Capture, tuple[HeldOut, ...]]:
    images = _folder(name) / "images"
    if name in POSED:
        dataset = read_dataset(_folder(name), settings.capture, split=split)
        capture = replace(training_capture(dataset, folder / "work", settings.capture, silent), given_labels=None)
        posed = [view.posed for view in dataset.test if view.posed is not None]
    else:
        whole = _whole(name, settings, cache)
        names = [view.posed.name for view in whole.views]
        test = names[::_EVERY]
        train = [photo_name for photo_name in names if photo_name not in test]
        if split == "validation":
            views = {view.posed.name: view for view in whole.views}
            test = list(validation_names(train, [views[photo_name].posed.world_from_camera for photo_name in train]))
            train = [photo_name for photo_name in train if photo_name not in test]
        capture = subset(whole, tuple(train))
        posed = [view.posed for view in whole.views if view.posed.name in test]
    return capture, tuple(HeldOut(camera.name, images / Path(camera.name).name, camera) for camera in posed)


def _whole(name: str, settings: Settings, cache: Path) -> Capture:
    """The capture of all photos of a data set without poses, by the service's structure from motion, once."""
    mark = cache / f"{name}-capture.pickle"
    if not mark.is_file():
        staged = cache / f"{name}-staged"
        staged.mkdir(parents=True, exist_ok=True)
        for path in sorted((_folder(name) / "images").iterdir()):
            (staged / path.name).write_bytes(path.read_bytes())
        mark.write_bytes(pickle.dumps(capture_folder(staged, cache / f"{name}-work", settings.capture, silent)))
    capture: Capture = pickle.loads(mark.read_bytes())
    return capture
