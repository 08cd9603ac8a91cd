"""The captures that are measured, with exact label maps: the table-top benchmark, the demo's sample, the skull."""

from __future__ import annotations

import os
import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.evaluation.validation_split import Split
from benchmarks.splits import HELD_OUT, with_split
from benchmarks.training.posed_folder import load_posed_folder
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.capture_files import load_capture
from fastsplat.service.common.progress import silent
from fastsplat.service.perception.label_maps.labelling import label_capture
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Labelling, Regions
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.training_views import capture_split, split_views

SCRATCH = Path(tempfile.gettempdir()) / "fastsplat-trade"
"""What rows share (a capture with points, trained scenes); may be deleted at any time."""

_SAMPLE = Path(__file__).parents[2] / "demo" / "sample"


@dataclass(frozen=True)
class BenchData:
    """A capture with the truth.

    Attributes:
        capture: posed, with points.
        truth: exact label maps of all views.
        train, test: positions of views; `test` those that are measured, which `capture.test_names` names.
        prompts: the labels that a detector is asked for: objects, not surfaces, and of the sample those it can know.
    """

    capture: Capture
    truth: Labelling
    train: tuple[int, ...]
    test: tuple[int, ...]
    prompts: tuple[str, ...]


def load_data(name: str, split: Split) -> BenchData:
    """ "tabletop", "skull" (of FASTSPLAT_TEST_DATA) or "sample"; every fifth view of these is a test view."""
    if name == "tabletop":
        capture, truth = load_posed_folder(Path(os.environ["FASTSPLAT_TEST_DATA"]) / "tabletop")
        surfaces: tuple[str, ...] = ("table", "floor", "wall")
    else:
        capture = _built(name)
        truth = label_capture(capture, PerceptionSettings(), Path(), (), silent)
        surfaces = ("plate", "tulip", "dining table")  # two that COCO has no class for, and the surface
        names = [view.posed.name for view in capture.views]
        capture = replace(capture, test_names=tuple(names[row] for row in split_views(len(names), HELD_OUT)[1]))
    capture, truth = with_split(capture, truth, capture.test_names, split)
    train, test = capture_split(capture, HELD_OUT)
    prompts = tuple(entry.label for entry in truth.dictionary.entries if entry.label not in surfaces)
    return BenchData(capture, replace(truth, exact=True), train, test, prompts)


def models() -> Path:
    """The model directory."""
    return Path(os.environ.get("FASTSPLAT_MODELS", ".models"))


def training_labels(data: BenchData, settings: Settings) -> Labelling:
    """What a detector and a segmenter make of the training views; the test views stay undetected."""
    part = replace(data.capture, views=tuple(data.capture.views[i] for i in data.train), given_labels=None)
    names = data.prompts if settings.perception.open_set_detector else ()
    detected = label_capture(part, settings.perception, settings.models, names, silent)
    maps = [np.zeros_like(label_map) for label_map in data.truth.label_maps]
    regions = [Regions(label_map, ()) for label_map in maps]
    for position, label_map, view in zip(data.train, detected.label_maps, detected.regions, strict=True):
        maps[position], regions[position] = label_map, view
    return Labelling(detected.dictionary, tuple(maps), regions=tuple(regions), detector=detected.detector)


def _built(name: str) -> Capture:
    built = SCRATCH / name
    if not built.is_dir():
        SCRATCH.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=SCRATCH) as work:
            # these load what a row's process does without
            from benchmarks.evaluation.datasets.reading import read_dataset
            from benchmarks.evaluation.datasets.training import training_capture
            from fastsplat.service.jobs.create_scene import capture_folder

            folder, settings = Path(work), CaptureSettings()
            if name == "sample":
                shutil.copytree(_SAMPLE, folder / "raw")
                (folder / "raw" / "README.md").unlink()
                capture_folder(folder / "raw", folder / "capture", settings)
            else:  # its masks become label maps by being read as a data set, which keeps one test view for itself
                data = read_dataset(Path(os.environ["FASTSPLAT_TEST_DATA"]) / name, settings, mask_label=name)
                names = (*data.train, *(view.name for view in data.test[1:]))
                training_capture(replace(data, train=names, test=data.test[:1]), folder, settings, silent)
            (folder / "capture").rename(built)
    return load_capture(built)
