"""The two captures that are measured: the table-top benchmark and the demo's sample, with exact label maps."""

from __future__ import annotations

import os
import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.training.data import load_posed_folder
from fastsplat.service.capture import admit_upload, build_capture, load_capture
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.types import Capture
from fastsplat.service.common.progress import silent
from fastsplat.service.perception import label_capture
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.types import Labelling, Regions
from fastsplat.service.splatting.training_views import split_views

HELD_OUT_EVERY = 5
SCRATCH = Path(tempfile.gettempdir()) / "fastsplat-trade"
"""What rows share (a capture with points, trained scenes); may be deleted at any time."""

_SAMPLE = Path(__file__).parents[2] / "demo" / "sample"


@dataclass(frozen=True)
class BenchData:
    """A capture with the truth.

    Attributes:
        capture: posed, with points.
        truth: exact label maps of all views.
        train, test: positions of views; every fifth is a test view.
        asked: the labels that a detector is asked for: things, not surfaces, and of the sample those it can know.
    """

    capture: Capture
    truth: Labelling
    train: tuple[int, ...]
    test: tuple[int, ...]
    asked: tuple[str, ...]


def load_data(name: str) -> BenchData:
    """ "tabletop" (found through FASTSPLAT_TEST_DATA) or "sample"."""
    if name == "tabletop":
        capture, truth = load_posed_folder(Path(os.environ["FASTSPLAT_TEST_DATA"]) / "tabletop")
        surfaces: tuple[str, ...] = ("table", "floor", "wall")
    else:
        capture = _sample()
        truth = label_capture(capture, PerceptionSettings(), Path(), (), silent)
        surfaces = ("plate", "tulip", "dining table")  # two that COCO has no class for, and the surface
    train, test = split_views(len(capture.views), HELD_OUT_EVERY)
    asked = tuple(entry.label for entry in truth.dictionary.entries if entry.label not in surfaces)
    return BenchData(capture, replace(truth, exact=True), train, test, asked)


def models() -> Path:
    """The model directory."""
    return Path(os.environ.get("FASTSPLAT_MODELS", ".models"))


def training_labels(data: BenchData, settings: PerceptionSettings) -> Labelling:
    """What a detector and a segmenter make of the training views; the test views stay undetected."""
    part = replace(data.capture, views=tuple(data.capture.views[i] for i in data.train), given_labels=None)
    names = data.asked if settings.open_set_detector else ()
    found = label_capture(part, settings, models(), names, silent)
    maps = [np.zeros_like(label_map) for label_map in data.truth.label_maps]
    regions = [Regions(label_map, ()) for label_map in maps]
    for position, label_map, seen in zip(data.train, found.label_maps, found.regions, strict=True):
        maps[position], regions[position] = label_map, seen
    return Labelling(found.dictionary, tuple(maps), regions=tuple(regions), expected=found.expected)


def _sample() -> Capture:
    built = SCRATCH / "sample"
    if not built.is_dir():
        SCRATCH.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=SCRATCH) as folder:
            raw = Path(folder) / "raw"
            shutil.copytree(_SAMPLE, raw)
            (raw / "README.md").unlink()
            admitted = admit_upload(raw, CaptureSettings())
            build_capture(admitted.folder, built, CaptureSettings(), silent)
    return load_capture(built)
