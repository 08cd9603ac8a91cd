"""Stages of a job that makes a scene: file input and output around `service.pipeline`."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from fastsplat.service.capture.formats.capture_files import load_capture
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.photos.scene_photos import write_photos
from fastsplat.service.capture.sfm.placed_cameras import placed_of
from fastsplat.service.capture.types import Capture
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.perception.labelling_files import load_labelling, save_labelling
from fastsplat.service.perception.types import Labelling
from fastsplat.service.pipeline import Provenance, assemble_scene, build_views, label_views, scene_quality, train_scene
from fastsplat.service.planning.cost_model import finish_seconds, run_seconds, scene_size
from fastsplat.service.planning.job_estimate import USUAL_LABELS, PhotoSet, capture_seconds, later_seconds
from fastsplat.service.planning.time_budget import clock_tradeoff, whole_export_seconds, with_tradeoffs
from fastsplat.service.planning.time_left import Forecast, with_time_left
from fastsplat.service.splatting.previews import TrainingWatch
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.types import TrainedSplats
from fastsplat.workers.budget import job_speed, make_plan, stored_plan
from fastsplat.workers.drafts import Drafts, early_views, export_made, training_drafts, write_made
from fastsplat.workers.progress_files import ProgressFiles, finish_requested
from fastsplat.workers.protocol import Job, Stage
from fastsplat.workers.results import PHOTOS, checkpoint_folder, intact, stage_seconds
from fastsplat.workers.trained_files import load_trained, save_trained
from fastsplat_contract.json_codec import to_plain

_TRADEOFFS = "tradeoffs.json"


def _capture(job: Job, folder: Path, progress: Progress) -> None:
    files = ProgressFiles(job, "capture", with_time_left(progress, capture_forecast(job)))
    options = job.options
    capture = build_views(
        job.upload,
        folder,
        job.settings,
        files.progress,
        up=options.up,
        on_placed=files.placed,
        movers=options.movers,
        privacy=options.privacy,
        exclude=job.exclude,
    )
    files.placed(placed_of(capture))
    (folder / PHOTOS).write_text(json.dumps([to_plain(photo) for photo in capture.report.photos]))


def _perception(job: Job, folder: Path, progress: Progress) -> None:
    capture = load_capture(job.result("capture"))
    report = with_time_left(progress, perception_forecast(job, capture))
    files = ProgressFiles(job, "perception", report)
    options, drafts = job.options, Drafts(job, files)

    def early(labelling: Labelling, views: Sequence[int]) -> None:
        drafts.of_points(capture, labelling, views)

    labelled = label_views(
        capture,
        job.settings,
        options.labels,
        files.progress,
        time_budget_s=options.time_budget_s,
        early=early if capture.splat is None else None,
    )
    save_labelling(labelled.labelling, folder)
    (folder / _TRADEOFFS).write_text(json.dumps(labelled.tradeoffs))


def _training(job: Job, folder: Path, progress: Progress) -> None:
    started = time.monotonic()
    capture, labelling = load_capture(job.result("capture")), load_labelling(job.result("perception"))
    plan = make_plan(job, capture, len(labelling.dictionary), started)
    report = with_time_left(progress, training_forecast(job, capture, len(labelling.dictionary), plan.settings))
    files = ProgressFiles(job, "training", with_tradeoffs(report, _tradeoffs(job)))
    settings = job.settings.model_copy(update={"training": plan.settings})
    drafts, views = Drafts(job, files), early_views(capture, labelling)

    def draft(splats: TrainedSplats, share: float) -> None:
        drafts.of_training(splats, capture, labelling, views, settings, share)

    watch = TrainingWatch(files.preview, finish_requested(job), draft, training_drafts())
    save_trained(train_scene(capture, labelling, settings, files.progress, checkpoint_folder(job), watch), folder)


def _export(job: Job, folder: Path, progress: Progress) -> None:
    export_made(job, folder, lambda: _assemble(job, folder, progress))


def _assemble(job: Job, folder: Path, progress: Progress) -> None:
    capture, labelling = load_capture(job.result("capture")), load_labelling(job.result("perception"))
    trained = load_trained(job.result("training"))
    seconds = {stage: stage_seconds(job, stage) for stage in ("capture", "perception", "training")}
    asked_s = job.options.time_budget_s
    tradeoffs = (*_tradeoffs(job), *clock_tradeoff(job.settings.training, asked_s, trained.quality))
    quality = scene_quality(trained, labelling, capture, Provenance(job.options.preset, tradeoffs, seconds, asked_s))
    settings = job.settings.model_copy(update={"training": stored_plan(job).settings})
    progress = with_time_left(progress, export_forecast(job, capture, len(labelling.dictionary)))
    scene = assemble_scene(trained, labelling, capture, settings, quality, progress)
    progress(ProgressEvent("export", 0.4, "writing the scene"))
    write_made(scene, folder)
    views = len(capture.views)

    def on_photo(done: int) -> None:
        progress(ProgressEvent("export", 0.8 + 0.2 * done / views, f"photos {done}/{views}"))

    write_photos(capture, folder, job.settings.photos, on_photo)


STAGES: Mapping[str, Stage] = {
    "capture": _capture, "perception": _perception, "training": _training, "export": _export,
}  # fmt: skip


def _tradeoffs(job: Job) -> tuple[str, ...]:
    """Lists reductions of perception and training due to the time budget."""
    path = job.result("perception") / _TRADEOFFS
    with intact(path):
        of_perception = json.loads(path.read_text()) if path.exists() else ()
    return (*of_perception, *stored_plan(job).tradeoffs)


def capture_forecast(job: Job) -> Forecast:
    """Of a job that begins: what photos without poses usually take; of everything else nothing is known yet."""
    manifest, _ = read_manifest(job.upload)
    if manifest.source != "images" or manifest.label_maps:
        return Forecast(None)
    middle = sorted(photo.upright_size for photo in manifest.photos)[len(manifest.photos) // 2]
    photos, speed = PhotoSet(len(manifest.photos), *middle), job_speed(job)
    later = sum(later_seconds(photos, job.settings, speed).values())
    if job.options.time_budget_s is not None:
        later = min(later, job.options.time_budget_s)
    return Forecast(later, capture_seconds(photos, job.settings, speed))


def perception_forecast(job: Job, capture: Capture) -> Forecast:
    """Of a job whose poses are known: its rate will tell how long perception takes; the rest the cost model says."""
    if capture.splat is not None:  # its labels are lifted, which nothing predicts
        return Forecast(None, bound_s=job.options.time_budget_s)
    settings, labels, speed = job.settings, len(job.options.labels) or USUAL_LABELS, job_speed(job)
    later = run_seconds(settings.training, scene_size(capture, labels), speed)
    later += whole_export_seconds(capture, settings, labels, speed)
    return Forecast(later, bound_s=job.options.time_budget_s)


def training_forecast(job: Job, capture: Capture, labels: int, planned: TrainingSettings) -> Forecast:
    """Of a job whose labels are known; `planned` is what it trains with."""
    speed = job_speed(job)
    later = whole_export_seconds(capture, job.settings, labels, speed)
    if capture.splat is not None:
        return Forecast(later)
    size = scene_size(capture, labels)
    return Forecast(later, run_seconds(planned, size, speed), finish_seconds(planned, size, speed))


def export_forecast(job: Job, capture: Capture, labels: int) -> Forecast:
    """Of a job that is trained."""
    return Forecast(0.0, whole_export_seconds(capture, job.settings, labels, job_speed(job)))
