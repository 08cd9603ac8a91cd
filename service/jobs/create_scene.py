"""Stages of scene creation (capture, labels, training, scene) as functions.

For an imported splat, missing pictures are rendered, and labels are lifted onto it instead of trained. Workers call the
stages one by one and keep each result (`workers.kinds.create_scene`); benchmarks and library users call
`build_scene`. All use `assemble_scene`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.sfm.placed_cameras import PlacedViews
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.common.progress import Progress, ProgressEvent, silent
from fastsplat.service.instances.naming.name_models import load_name_model
from fastsplat.service.instances.naming.object_appearances import with_appearances
from fastsplat.service.instances.naming.object_reads import with_reads
from fastsplat.service.instances.scene_objects import find_scene_objects
from fastsplat.service.jobs.names_by_looks import named_by_looks
from fastsplat.service.perception.appearance import open_appearance_encoder
from fastsplat.service.perception.detectors.open_detectors import open_closed_set_detector
from fastsplat.service.perception.image_text import find_image_text
from fastsplat.service.perception.label_maps.capture_masks import propose_capture_masks
from fastsplat.service.perception.label_maps.early_look import ShowEarly
from fastsplat.service.perception.label_maps.labelling import label_capture
from fastsplat.service.perception.label_maps.movers import open_withholding
from fastsplat.service.perception.onnx_session import use_backend
from fastsplat.service.perception.readers.ppocr import find_reader
from fastsplat.service.perception.results import Labelling
from fastsplat.service.perception.segmenters.open_segmenter import open_segmenter
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.planning.presets import PresetName
from fastsplat.service.planning.time_budget import plan_perception
from fastsplat.service.query.language.meaning.embeddings import embed_labels
from fastsplat.service.query.phrases.looks_files import load_calibration
from fastsplat.service.scene.artefact.scene import Gaussians, Objects, Scene, SceneFacts, SemanticHead
from fastsplat.service.settings import Settings
from fastsplat.service.splat_import.label_lifting import lift_labels
from fastsplat.service.splat_import.pictures import render_views
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training.previews import UNWATCHED, TrainingWatch
from fastsplat.service.splatting.training.train import train
from fastsplat_contract.jobs.operations import Movers, Privacy, UpAxis

OBJECTS_SHARE = 0.3
"""Share of the export's progress."""
_LOOKING_SHARE = 0.85
"""Share of `OBJECTS_SHARE` for proposing masks that perception did not."""
_READING_FROM = 0.95
"""Share of `OBJECTS_SHARE` at which reading begins."""


@dataclass(frozen=True)
class LabelledViews:
    labelling: Labelling
    tradeoffs: tuple[str, ...] = ()  # reductions due to the time budget, in words


@dataclass(frozen=True)
class BuiltScene:
    """A scene with its labelling and seconds by stage (capture only if known)."""

    scene: Scene
    labelling: Labelling
    stage_seconds: Mapping[str, float]


def capture_folder(folder: Path, work: Path, settings: CaptureSettings, progress: Progress = silent) -> Capture:
    """Validates and captures a folder of photos, a video, an archive or posed data.

    Writes `folder/.validated`; `work` must not exist. Raises as `validate_upload` and `build_capture`.
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
    """Builds the capture of a validated upload, rendering pictures around a splat without photos.

    Args:
        validated_dir: `ValidatedUpload.folder`.
        out_dir: new, empty, or an earlier capture, which is replaced.
        up: up axis of a splat without photos; None: estimated.
        on_placed, exclude: as for `build_capture`.
        movers, privacy: redaction of photos, see `SceneOptions`; pictures of a splat are used whole.

    Raises:
        FastSplatError: the device is missing (checked first); as `build_capture`, `open_withholding`, `render_views`.
    """
    backend = settings.training.backend
    use_backend(backend)
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
    """Labels the capture's views, from supplied label maps or by detection.

    Args:
        settings: with the preset applied.
        labels: names to look for; empty: anything.
        time_budget_s: seconds for perception, training and export together; None: no bound.
        early: as for `label_capture`, also errors.
    """
    plan = plan_perception(capture, settings, labels, time_budget_s, progress, started=time.monotonic())
    masks = settings.discovery.proposes(given_labels=capture.given_labels is not None)
    labelling = label_capture(
        capture, plan.settings, settings.models, tuple(labels), progress, masks=masks, early=early
    )
    planned = min(plan.settings.max_views or len(capture.views), len(capture.views))
    looked = planned if labelling.looked_at is None else len(labelling.looked_at)
    words = (f"words looked for in {looked} of {planned} views",) if looked < planned else ()
    return LabelledViews(labelling, (*plan.tradeoffs, *words))


def train_scene(
    capture: Capture,
    labelling: Labelling,
    settings: Settings,
    progress: Progress = silent,
    checkpoint_dir: Path | None = None,
    watch: TrainingWatch = UNWATCHED,
) -> TrainedSplats:
    """Trains Gaussians, or lifts labels onto the capture's own splat, keeping its order.

    Args:
        labelling: one label map per view.
        settings: with the preset and the training plan applied.
        checkpoint_dir, watch: as for `train`; unused for an imported splat.

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
    capture_seconds: float | None = None,
) -> BuiltScene:
    """Labels, trains and assembles a scene in this process.

    Args:
        settings: with the preset applied (`service.planning.presets.apply_preset`).
        labels: names to look for; empty: anything.
        labelling: replaces perception.
        preset, capture_seconds: recorded in the scene.

    Raises:
        ModelUnavailableError: the training device or a required model is missing (checked first).
        FastSplatError: as the stages.
    """
    use_backend(settings.training.backend)
    device_of(settings.training.backend)
    open_text_encoder(settings.perception.text_encoder, settings.models)  # a missing model fails before the training
    if settings.discovery.objects == "on":
        open_segmenter(settings.perception, settings.models)
        open_closed_set_detector(settings.perception, settings.models)
    seconds = {} if capture_seconds is None else {"capture": capture_seconds}
    begun = time.monotonic()
    labelled = label_views(capture, settings, labels) if labelling is None else LabelledViews(labelling)
    seconds["perception"] = time.monotonic() - begun
    begun = time.monotonic()
    trained = train_scene(capture, labelled.labelling, settings)
    seconds["training"] = time.monotonic() - begun
    begun = time.monotonic()
    scene = assemble_scene(trained, labelled.labelling, capture, settings, SceneFacts(preset=preset), seconds)
    seconds["export"] = time.monotonic() - begun
    return BuiltScene(scene, labelled.labelling, seconds)


def assemble_scene(
    trained: TrainedSplats,
    labelling: Labelling,
    capture: Capture,
    settings: Settings,
    plan_facts: SceneFacts,
    stage_seconds: Mapping[str, float],
    progress: Progress = silent,
    *,
    described: bool = True,
) -> Scene:
    """Assembles a trained scene: embeds its labels and adds discovered objects.

    Args:
        labelling: used in training; its dictionary becomes the scene's.
        settings: `settings.training` was used for the training, and is recorded.
        plan_facts: preset, tradeoffs and time_asked_s.
        described: as for `find_objects`.

    Raises:
        ModelUnavailableError: the text encoder is missing, or the segmenter that discovery needs.
    """
    objects, gaussians = find_objects(trained, labelling, capture, settings, progress, described=described)
    learnt = labelling.learnt() is labelling and (objects is None or objects.head is None)
    dictionary, head = labelling.dictionary, trained.head
    if not learnt:
        head = SemanticHead.unlearnt(len(dictionary), gaussians.codes.shape[1])
    for name in dict.fromkeys(obj.name for obj in (objects.table if objects else ()) if obj.name):
        if dictionary.id_of(name) is None:  # by its looks, which no detector looked for
            dictionary, head = Dictionary((*dictionary.entries, DictionaryEntry(name))), head.grown()
    progress(ProgressEvent("export", OBJECTS_SHARE, f"embedding {len(dictionary)} labels"))
    encoder = open_text_encoder(settings.perception.text_encoder, settings.models)
    templates = settings.query.templates
    return Scene(
        gaussians=gaussians,
        head=head,
        dictionary=dictionary,
        label_embeddings=embed_labels(dictionary, encoder, templates),
        text_encoder=(encoder.name, encoder.sha256),
        cameras=tuple(view.posed for view in capture.views),
        scale=capture.scale,
        training=settings.training.model_dump(mode="json") if capture.splat is None else {},
        quality=scene_quality(trained, capture, stage_seconds),
        facts=scene_facts(trained, labelling, capture, settings, plan_facts),
        label_templates=templates,
        evidence=trained.evidence,
        objects=objects,
    )


def scene_facts(
    trained: TrainedSplats, labelling: Labelling, capture: Capture, settings: Settings, plan_facts: SceneFacts
) -> SceneFacts:
    """Collects origin and state of a scene; photo times only where photos are kept and nobody is redacted."""
    report, scale, vertical = capture.report, capture.report.scale, capture.report.vertical
    private = is_private(capture, settings)
    model = load_name_model(labelling.detector, settings.models)
    share = (model.found_share if model else 0.0) if labelling.regions else None
    unmeasured = (f"the scores of {labelling.detector} are not measured: its names are suggestions",) * (share == 0.0)
    times = {} if private else {v.posed.name: v.taken_at for v in capture.views if v.taken_at is not None}
    names = [entry.label for entry in labelling.dictionary.entries] if labelling.exact else labelling.searched
    return replace(
        plan_facts,
        source=report.source,
        splat=report.splat,
        tradeoffs=plan_facts.tradeoffs or (),
        stopped_early="stopped_at_share" in trained.quality,
        warnings=(*report.warnings, *trained.warnings, *unmeasured),
        unregistered=report.unregistered,
        left_out=report.left_out,
        withheld=report.withheld,
        taken_at=times or None,
        held_out_views=tuple(trained.held_out),
        label_source="none" if not len(labelling.dictionary) else "given" if labelling.exact else "detected",
        searched_names=None if names is None else len(names),
        searched_for=None if names is None else tuple(names),
        found_shares={} if share is None else dict.fromkeys(names or (), share),
        scale_source=None if scale is None else scale.source,
        scale_error_95=None if scale is None else scale.relative_error_95,
        vertical_source=None if vertical is None else vertical.source,
        vertical_deviation_deg=None if vertical is None else vertical.deviation_deg,
    )


def scene_quality(trained: TrainedSplats, capture: Capture, stage_seconds: Mapping[str, float]) -> dict[str, Any]:
    """Measurements of a scene, ready for JSON: training metrics, counts, seconds, photometric corrections if any."""
    corrections = {name: [round(value, 4) for value in row] for name, row in trained.photometric.items()}
    return {
        **trained.quality,
        **({"photometric": corrections} if corrections else {}),
        "gaussians": len(trained.gaussians),
        "images": capture.report.images,
        "registered": len(capture.views),
        "mean_reprojection_error_px": capture.report.mean_reprojection_error_px,
        "stage_seconds": dict(stage_seconds),
    }


def is_private(capture: Capture, settings: Settings) -> bool:
    """True if photos are not kept, or people are redacted."""
    withheld = capture.report.withheld
    return settings.photos.keep == "off" or (withheld is not None and withheld.privacy is not None)


def find_objects(
    trained: TrainedSplats,
    labelling: Labelling,
    capture: Capture,
    settings: Settings,
    progress: Progress,
    *,
    described: bool = True,
) -> tuple[Objects | None, Gaussians]:
    """Discovers objects, if any; also returns the Gaussians with their codes.

    Without detected regions, objects are discovered only if `settings.discovery.objects` is "on".

    Args:
        capture: if `is_private`, no text is read and no image-text model is run.
        progress: stage "export", up to `OBJECTS_SHARE`.
        described: also compute appearances and read text.

    Raises:
        ModelUnavailableError: the segmenter that discovery needs is missing, or another model's file is damaged.
    """
    looked_for, detected = labelling.masks, [regions.masks() for regions in labelling.regions]
    training, discovery, models = settings.training, settings.discovery, settings.models
    if not detected and discovery.objects != "on":
        return None, trained.gaussians

    def tell(what: str, begin: float, end: float) -> Callable[[int, int], None]:
        def on_view(done: int, total: int) -> None:
            fraction = OBJECTS_SHARE * (begin + (end - begin) * done / total)
            progress(ProgressEvent("export", fraction, f"{what}, view {done}/{total}"))

        return on_view

    masks, begin = looked_for or detected, 0.0
    if not masks:
        looking, begin = tell("looking for objects", 0, _LOOKING_SHARE), _LOOKING_SHARE
        masks = propose_capture_masks(capture.views, settings.perception, models, looking)
    on_view = tell("discovering objects", begin, _READING_FROM)
    name_model = load_name_model(labelling.detector, models)
    objects, gaussians = find_scene_objects(
        trained.gaussians, capture, labelling, masks, discovery, on_view, training=training, name_model=name_model
    )
    if not objects.table and not detected:
        return None, trained.gaussians
    if discovery.objects == "off" or not described:
        return objects, gaussians
    side, backend, private = discovery.max_side, training.backend, is_private(capture, settings)
    encoder = open_appearance_encoder(settings.perception, models)
    looks = None if private else find_image_text(settings.perception, models)
    if encoder or looks:
        objects = with_appearances(objects, gaussians, capture.views, encoder, side, looks=looks, backend=backend)
    if looks and (model := load_calibration(looks, models)):
        objects = named_by_looks(objects, model, [entry.label for entry in labelling.dictionary.entries])
    if not private:
        reader, on_view = find_reader(settings.perception, models), tell("reading", _READING_FROM, 1.0)
        objects = with_reads(objects, gaussians, capture.views, reader, side, on_view, backend=backend)
    return objects, gaussians
