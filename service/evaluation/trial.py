"""A scene trained on the training split of a data set, with what that cost."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from fastsplat.service.capture.types import Capture
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import Progress
from fastsplat.service.evaluation.datasets import Dataset, training_capture
from fastsplat.service.perception import label_capture
from fastsplat.service.perception.text import open_text_encoder
from fastsplat.service.perception.types import Labelling
from fastsplat.service.query import embed_labels
from fastsplat.service.scene import Scene
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.train import train
from fastsplat_contract.errors import InvalidInputError

LabelSource = Literal["given", "detected"]


@dataclass(frozen=True)
class Trial:
    """What a training run left.

    Attributes:
        scene: ready to be asked; its cameras are the training views alone.
        seconds: by stage: capture, perception, training, export.
        peak_mb: highest resident memory of this process so far, 10^6 bytes.
    """

    scene: Scene
    seconds: Mapping[str, float]
    peak_mb: float


def train_on(dataset: Dataset, settings: Settings, labels: LabelSource, work: Path, progress: Progress) -> Trial:
    """Capture, perception, training and export as a job runs them, on the training views and nothing else.

    Every one of them is trained on: `held_out_every` of the settings does not count here.

    Args:
        dataset: see `read_dataset`.
        settings: of all rooms.
        labels: `given`: the data set's label maps; `detected`: the configured models look at the images for the data
            set's labels by name. A data set without labels is trained without.
        work: an empty folder for what lies in between.
        progress: hears of every stage; may raise `CancelledError`.

    Raises:
        InvalidInputError: `given`, and the training views have no label maps.
        FastSplatError: whatever the stages raise.
    """
    seconds: dict[str, float] = {}
    clock = time.perf_counter()

    def lap(stage: str) -> None:
        nonlocal clock
        seconds[stage], clock = time.perf_counter() - clock, time.perf_counter()

    training = settings.training.model_copy(update={"held_out_every": 0})
    encoder = open_text_encoder(settings.perception.text_encoder, settings.models)  # fails before minutes of training
    capture = training_capture(dataset, work, settings.capture, progress)
    lap("capture")
    labelling = _labelling(dataset, capture, settings, labels, progress)
    lap("perception")
    trained = train(capture, labelling, training, progress)
    lap("training")
    templates = settings.query.templates
    scene = Scene(
        gaussians=trained.gaussians,
        head=trained.head,
        dictionary=labelling.dictionary,
        label_embeddings=embed_labels(labelling.dictionary, encoder, templates),
        text_encoder=(encoder.name, encoder.sha256),
        cameras=tuple(view.posed for view in capture.views),
        scale=capture.scale,
        training=training.model_dump(mode="json"),
        quality={**trained.quality, "held_out_views": [], "label_source": labels, "stage_seconds": dict(seconds)},
        label_templates=templates,
        evidence=trained.evidence,
        label_mode=trained.label_mode,
    )
    lap("export")
    return Trial(scene, seconds, peak_megabytes())


def peak_megabytes() -> float:
    """Highest resident memory of this process so far, 10^6 bytes."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def _labelling(
    dataset: Dataset, capture: Capture, settings: Settings, labels: LabelSource, progress: Progress
) -> Labelling:
    names = tuple(entry.label for entry in dataset.dictionary.entries)
    if not names:
        return Labelling(Dictionary(()), ())
    if labels == "detected":
        blind = replace(capture, given_labels=None)
        return label_capture(blind, settings.perception, settings.models, names, progress)
    if capture.given_labels is None:
        raise InvalidInputError(
            f"{dataset.folder.name} has no label maps for its training views",
            field="labels",
            hint="Let the models find the labels: --labels detected.",
        )
    return label_capture(capture, settings.perception, settings.models, (), progress)
