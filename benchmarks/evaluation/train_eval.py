"""Training on the training split of a data set, with its cost."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from benchmarks.evaluation.datasets.dataset import Dataset
from benchmarks.evaluation.datasets.training import training_capture
from benchmarks.provenance import peak_megabytes
from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import silent
from fastsplat.service.jobs.create_scene import build_scene
from fastsplat.service.perception.results import Labelling
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.planning.presets import PresetName, override_training
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import InvalidInputError

TrainingLabels = Literal["given", "detected", "discovered", "default"]
"""`given`: the data set's label maps; `detected`: the models find them, prompted with the data set's label names;
`discovered`: no names at all, the scene gets objects instead; `default`: what a job makes of photos without a word, the
models name what they know."""


@dataclass(frozen=True)
class TrainedScene:
    """The scene of a training split, with what it cost.

    Attributes:
        scene: ready to be asked; its cameras are the training views alone.
        seconds: by stage: capture, perception, training, export.
        peak_mb: highest resident memory of this process so far, 10^6 bytes.
    """

    scene: Scene
    seconds: Mapping[str, float]
    peak_mb: float


def train_on_split(
    dataset: Dataset,
    settings: Settings,
    work: Path,
    *,
    labels: TrainingLabels = "given",
    preset: PresetName | None = None,
) -> TrainedScene:
    """A scene trained as a job trains it (`service.jobs.create_scene`), on the training views and nothing else.

    Every training view is trained on: `held_out_every` of the settings does not count here.

    Args:
        dataset: see `read_dataset`.
        settings: of all rooms, with the preset applied.
        work: an empty folder for intermediate files.
        labels: where the labels come from; a data set without labels is trained without.
        preset: recorded in the scene.

    Raises:
        InvalidInputError: `given`, and the training views have no label maps.
        FastSplatError: whatever the stages raise.
    """
    open_text_encoder(settings.perception.text_encoder, settings.models)  # a missing model fails before the capture
    begun = time.monotonic()
    capture = training_capture(dataset, work, settings.capture, silent)
    capture_seconds = time.monotonic() - begun
    names = tuple(entry.label for entry in dataset.dictionary.entries) if labels in ("given", "detected") else ()
    if labels == "discovered":
        discovery = settings.discovery.model_copy(update={"objects": "on"})
        settings = settings.model_copy(update={"discovery": discovery})
    built = build_scene(
        _with_label_source(capture, dataset, labels),
        override_training(settings, held_out_every=0),
        labels=names if labels == "detected" else (),
        labelling=None if names or labels == "default" else Labelling(Dictionary(()), ()),
        preset=preset,
        capture_seconds=capture_seconds,
    )
    return TrainedScene(built.scene, built.stage_seconds, peak_megabytes())


def _with_label_source(capture: Capture, dataset: Dataset, labels: TrainingLabels) -> Capture:
    if labels != "given":
        return replace(capture, given_labels=None)
    if len(dataset.dictionary) and capture.given_labels is None:
        raise InvalidInputError(
            f"{dataset.folder.name} has no label maps for its training views",
            field="labels",
            hint="Let the models find the labels: --labels detected.",
        )
    return capture
