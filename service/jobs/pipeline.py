"""Capture, labels, training, scene: the stages of a scene as functions, and the one place that puts a scene together.

Around a splat of another tool pictures are rendered where it has none, and labels are lifted onto it, not trained.
A worker calls the stages one by one and keeps the result of each (`workers.kinds.create_scene_stages`); benchmarks and
library users call `build_scene`. Every caller assembles its scene with `assemble_scene`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.sfm.placed_cameras import PlacedViews
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import Progress, ProgressEvent, silent
from fastsplat.service.jobs.things_of_photos import THINGS_SHARE, find_things, is_private
from fastsplat.service.perception.detectors.open_detectors import open_closed_set_detector
from fastsplat.service.perception.label_maps.early_look import ShowEarly
from fastsplat.service.perception.label_maps.labelling import label_capture
from fastsplat.service.perception.label_maps.movers import open_withholding
from fastsplat.service.perception.results import Labelling
from fastsplat.service.perception.segmenters.open_segmenter import open_segmenter
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.planning.presets import PresetName
from fastsplat.service.planning.time_budget import clock_tradeoff, plan_perception, plan_training, with_tradeoffs
from fastsplat.service.query.language.meaning.embeddings import embed_labels
from fastsplat.service.scene.artefact.scene import TAKEN_AT, Scene, SemanticHead
from fastsplat.service.scene.artefact.upright import vertical_figures
from fastsplat.service.settings import Settings
from fastsplat.service.splat_import.label_lifting import lift_labels
from fastsplat.service.splat_import.pictures import render_views
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training.previews import UNWATCHED, TrainingWatch
from fastsplat.service.splatting.training.train import train
from fastsplat_contract.jobs.operations import Movers, Privacy, UpAxis

LabelSource = Literal["none", "given", "detected"]
"""Where a scene's labels come from: it has none, label maps came with the capture, models detected them."""


@dataclass(frozen=True)
class LabelledViews:
    """The result of perception; `tradeoffs`: what the time budget reduced, in words."""

    labelling: Labelling
    tradeoffs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Provenance:
    """How a scene came about, beside what training measured.

    Attributes:
        preset: that was applied to the settings, or None.
        tradeoffs: what the time budget reduced, in words.
        stage_seconds: by stage.
        time_asked_s: seconds for everything after the capture stage, or None where nobody asked for a time.
    """

    preset: PresetName | None = None
    tradeoffs: tuple[str, ...] = ()
    stage_seconds: Mapping[str, float] = field(default_factory=dict)
    time_asked_s: float | None = None


@dataclass(frozen=True)
class BuiltScene:
    """A scene with what it was made of.

    Attributes:
        scene: ready to be stored and asked.
        labelling: what it was trained on.
        stage_seconds: by stage: perception, training, export.
    """

    scene: Scene
    labelling: Labelling
    stage_seconds: Mapping[str, float]


def capture_folder(folder: Path, work: Path, settings: CaptureSettings, progress: Progress = silent) -> Capture:
    """The capture of a folder of photos, a video, an archive or a posed data set, checked as any upload is.

    Args:
        folder: the files; its subfolder `.validated` is written.
        work: a folder for the result, which must not exist.
        settings: limits, and how poses are found.
        progress: hears of the stage; may raise `CancelledError`.

    Raises:
        FastSplatError: as `validate_upload` and `build_capture`.
    """
    return build_capture(validate_upload(folder, settings).folder, work, settings, progress)


def build_views(
    validated_dir: Path,
    out_dir: Path,
    settings: Settings,
    progress: Progress = silent,
    *,
    up: UpAxis | None = None,
    on_placed: Callable[[PlacedViews], None] | None = None,
    movers: Movers | None = None,
    privacy: Privacy | None = None,
    exclude: Collection[str] = (),
) -> Capture:
    """The capture of any validated upload: of its images, or of pictures rendered around a splat that came alone.

    Args:
        validated_dir: `ValidatedUpload.folder`.
        out_dir: new, empty, or an earlier capture, which is replaced.
        settings: of all rooms.
        progress: hears of the stage "capture"; may raise `CancelledError`.
        up: for a splat alone: which axis of its world is up; None: estimated.
        on_placed: as for `build_capture`.
        movers, privacy: what to leave out of the photos, see `SceneOptions`; pictures of a splat are used whole.
        exclude: as for `build_capture`.

    Raises:
        FastSplatError: the device is missing, said first; as `build_capture`, `open_withholding`, `render_views`.
    """
    backend = settings.training.backend
    device_of(backend)
    if read_manifest(validated_dir)[0].source != "splat":
        withholding = open_withholding(movers, privacy, settings.perception, settings.models)
        return build_capture(validated_dir, out_dir, settings.capture, progress, on_placed, withholding, exclude)
    return render_views(validated_dir, out_dir, settings.splat_import, progress, up=up, backend=backend)


def label_views(
    capture: Capture,
    settings: Settings,
    labels: Sequence[str] = (),
    progress: Progress = silent,
    *,
    time_budget_s: float | None = None,
    early: ShowEarly | None = None,
) -> LabelledViews:
    """Label maps of the capture's views, from the capture itself or from detection.

    Args:
        capture: registered images.
        settings: of all rooms, with the preset applied.
        labels: names to look for; empty: whatever is there.
        progress: hears of every view; may raise `CancelledError`.
        time_budget_s: seconds for perception, training and export together; None: no bound.
        early: as for `label_capture`.

    Raises:
        FastSplatError: as `label_capture`.
    """
    plan = plan_perception(capture, settings, labels, time_budget_s, progress, started=time.monotonic())
    masks = settings.discovery.proposes(given_labels=capture.given_labels is not None)
    labelling = label_capture(
        capture, plan.settings, settings.models, tuple(labels), progress, masks=masks, early=early
    )
    return LabelledViews(labelling, plan.tradeoffs)


def train_scene(
    capture: Capture,
    labelling: Labelling,
    settings: Settings,
    progress: Progress = silent,
    checkpoint_dir: Path | None = None,
    watch: TrainingWatch = UNWATCHED,
) -> TrainedSplats:
    """Trained Gaussians, with their labels where label maps came with the capture; those of the capture's splat, in its
    order, where it brought one.

    Args:
        capture: registered images.
        labelling: one label map per view.
        settings: of all rooms, with the preset applied and the training planned.
        progress: hears of the stage "training"; may raise `CancelledError`.
        checkpoint_dir, watch: as for `train`; a splat that was brought along is not trained, and shows nothing.

    Raises:
        FastSplatError: as `train` and `lift_labels`.
    """
    learnt = labelling.learnt()
    if capture.splat is None:
        return train(capture, learnt, settings.training, progress, checkpoint_dir, watch=watch)
    return lift_labels(capture, learnt, settings.training, settings.splat_import, progress)


def build_scene(
    capture: Capture,
    settings: Settings,
    *,
    labels: Sequence[str] = (),
    labelling: Labelling | None = None,
    preset: PresetName | None = None,
    time_budget_s: float | None = None,
    capture_seconds: float | None = None,
    progress: Progress = silent,
) -> BuiltScene:
    """A scene of a capture: labelled, trained and assembled in this process.

    Args:
        capture: registered images.
        settings: of all rooms, with the preset applied (`service.planning.presets.apply_preset`).
        labels: names to look for; empty: whatever is there.
        labelling: in place of perception, where the labels are known.
        preset: recorded in the scene.
        time_budget_s: seconds for perception, training and export together; None: no bound beside the settings' own.
        capture_seconds: what the capture took, recorded in the scene.
        progress: hears of every stage; may raise `CancelledError`.

    Raises:
        ModelUnavailableError: the training's device or a model that is needed is missing, said before all else.
        FastSplatError: whatever the stages raise.
    """
    device_of(settings.training.backend)
    open_text_encoder(settings.perception.text_encoder, settings.models)  # a missing model fails before the training
    if settings.discovery.things == "on":
        open_segmenter(settings.perception, settings.models)
        open_closed_set_detector(settings.perception, settings.models)
    seconds = {} if capture_seconds is None else {"capture": capture_seconds}
    begun = time.monotonic()
    if labelling is None:
        labelled = label_views(capture, settings, labels, progress, time_budget_s=time_budget_s)
    else:
        labelled = LabelledViews(labelling)
    seconds["perception"] = time.monotonic() - begun
    begun = time.monotonic()
    count = len(labelled.labelling.dictionary)
    plan = plan_training(capture, settings, count, time_budget_s, spent_s=seconds["perception"])
    tradeoffs = (*labelled.tradeoffs, *plan.tradeoffs)
    used = settings.model_copy(update={"training": plan.settings})
    trained = train_scene(capture, labelled.labelling, used, with_tradeoffs(progress, tradeoffs))
    seconds["training"] = time.monotonic() - begun
    begun = time.monotonic()
    tradeoffs += clock_tradeoff(settings.training, time_budget_s, trained.quality)
    provenance = Provenance(preset, tradeoffs, dict(seconds), time_budget_s)
    quality = scene_quality(trained, labelled.labelling, capture, provenance)
    scene = assemble_scene(trained, labelled.labelling, capture, used, quality, progress)
    seconds["export"] = time.monotonic() - begun
    return BuiltScene(scene, labelled.labelling, seconds)


def assemble_scene(
    trained: TrainedSplats,
    labelling: Labelling,
    capture: Capture,
    settings: Settings,
    quality: Mapping[str, Any],
    progress: Progress = silent,
    *,
    described: bool = True,
) -> Scene:
    """The scene of a finished training, its labels embedded and, if `settings.discovery` asks for it, with things.

    Args:
        trained: Gaussians, head and evidence.
        labelling: what they were trained on; its dictionary becomes the scene's.
        capture: its cameras and scale become the scene's.
        settings: of all rooms; `settings.training` is what was trained with, and is recorded.
        quality: figures and facts, ready for JSON, see `scene_quality`; the scene's also has `searched_for`, the names
            that were looked for, and `searched_names`, how many they are, if that is known; and `taken_at`, when the
            photos were taken, by name, seconds since 1970, of those that say it.
        progress: hears of the stage "export".
        described: as for `find_things`.

    Raises:
        ModelUnavailableError: the text encoder of the settings is missing, or the segmenter that discovery needs.
    """
    things, gaussians = find_things(trained, labelling, capture, settings, progress, described=described)
    learnt = labelling.learnt() is labelling and (things is None or things.head is None)
    count, code = len(labelling.dictionary), gaussians.codes.shape[1]
    progress(ProgressEvent("export", THINGS_SHARE, f"embedding {len(labelling.dictionary)} labels"))
    encoder = open_text_encoder(settings.perception.text_encoder, settings.models)
    templates = settings.query.templates
    return Scene(
        gaussians=gaussians,
        head=trained.head if learnt else SemanticHead.unlearnt(count, code),
        dictionary=labelling.dictionary,
        label_embeddings=embed_labels(labelling.dictionary, encoder, templates),
        text_encoder=(encoder.name, encoder.sha256),
        cameras=tuple(view.posed for view in capture.views),
        scale=capture.scale,
        training=settings.training.model_dump(mode="json") if capture.splat is None else {},
        quality={**quality, **_searched(labelling), **_photo_times(capture, settings)},
        label_templates=templates,
        evidence=trained.evidence,
        things=things,
    )


def _photo_times(capture: Capture, settings: Settings) -> dict[str, Any]:
    """When photos were taken, by name, if they say it; of none where no photo is to stay, or people are withheld."""
    if is_private(capture, settings):
        return {}
    times = {view.posed.name: view.taken_at for view in capture.views if view.taken_at is not None}
    return {TAKEN_AT: times} if times else {}


def _searched(labelling: Labelling) -> dict[str, Any]:
    names = [entry.label for entry in labelling.dictionary.entries] if labelling.exact else labelling.searched
    return {} if names is None else {"searched_names": len(names), "searched_for": list(names)}


def scene_quality(
    trained: TrainedSplats, labelling: Labelling, capture: Capture, provenance: Provenance
) -> dict[str, Any]:
    """What a scene's manifest says of how well it was made, ready for JSON.

    What training measured, and: stopped_early (whether somebody ended the training before its plan did), preset,
    tradeoffs, label_source, gaussians, held_out_views, images, registered, unregistered, left_out (why, by file),
    source, splat, warnings, mean_reprojection_error_px, stage_seconds; where meters were measured, scale_source and
    scale_error_95 (half of the 95 % interval of a length, as a share of it); where pixels were left out of the photos,
    withheld (`WithheldReport`); of a world made upright, vertical_source and vertical_deviation_deg; where photos were
    corrected, photometric (see `TrainedSplats`); where a time was asked for, time_asked_s.
    """
    report, scale, withheld = capture.report, capture.report.scale, capture.report.withheld
    held_back = {} if withheld is None else {"withheld": asdict(withheld)}
    measured = {} if scale is None else {"scale_source": scale.source, "scale_error_95": scale.relative_error_95}
    if (vertical := report.vertical) is not None:
        measured |= vertical_figures(vertical.source, vertical.deviation_deg)
    asked = {} if provenance.time_asked_s is None else {"time_asked_s": provenance.time_asked_s}
    return {
        **trained.quality,
        **asked,
        **measured,
        **held_back,
        **_photometric(trained),
        "stopped_early": "stopped_at_share" in trained.quality,
        "preset": provenance.preset,
        "tradeoffs": list(provenance.tradeoffs),
        "label_source": _label_source(labelling),
        "gaussians": len(trained.gaussians),
        "held_out_views": list(trained.held_out),
        "images": report.images,
        "registered": len(capture.views),
        "unregistered": list(report.unregistered),
        "left_out": dict(report.left_out),
        "source": report.source,
        "splat": report.splat,
        "warnings": [*report.warnings, *trained.warnings],
        "mean_reprojection_error_px": report.mean_reprojection_error_px,
        "stage_seconds": dict(provenance.stage_seconds),
    }


def _photometric(trained: TrainedSplats) -> dict[str, Any]:
    """The photos' corrections as a scene's manifest has them."""
    rows = trained.photometric
    return {"photometric": {name: [round(value, 4) for value in row] for name, row in rows.items()}} if rows else {}


def _label_source(labelling: Labelling) -> LabelSource:
    if not len(labelling.dictionary):
        return "none"
    return "given" if labelling.exact else "detected"
