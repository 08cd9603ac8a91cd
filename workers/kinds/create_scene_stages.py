"""Stages of a job that makes a scene: file input and output around `service.jobs.pipeline`."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fastsplat.service.capture.formats.capture_files import load_capture
from fastsplat.service.capture.photos.scene_photos import write_photos
from fastsplat.service.capture.sfm.placed_cameras import placed_of
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.jobs.pipeline import assemble_scene, build_views, label_views, train_scene
from fastsplat.service.perception.label_maps.labelling_files import load_labelling, save_labelling
from fastsplat.service.perception.results import Labelling
from fastsplat.service.planning.job_time import with_time_left
from fastsplat.service.planning.time_budget import clock_tradeoff, with_tradeoffs
from fastsplat.service.scene.artefact.scene import Evidence, Gaussians, SceneFacts, SemanticHead
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training.previews import TrainingWatch
from fastsplat.workers.job.protocol import Job, Stage
from fastsplat.workers.job.results import PHOTOS, checkpoint_folder, intact, stage_seconds
from fastsplat.workers.kinds.budget import job_time, make_plan, stored_plan
from fastsplat.workers.kinds.drafts import TRAINING_DRAFTS, Drafts, early_views, export_made, write_made
from fastsplat.workers.kinds.progress_files import ProgressFiles, finish_requested
from fastsplat_contract.codec.json_codec import to_plain


def save_trained(trained: TrainedSplats, folder: Path) -> None:
    """Writes a training result: `arrays.npz` and `report.json`."""
    arrays = {**vars(trained.gaussians), "weight": trained.head.weight, "bias": trained.head.bias}
    if trained.evidence is not None:
        arrays |= {f"evidence.{name}": array for name, array in vars(trained.evidence).items()}
    np.savez(folder / "arrays.npz", **arrays)
    report = {name: getattr(trained, name) for name in ("held_out", "photometric", "warnings")}
    report |= {"quality": dict(trained.quality)}
    (folder / "report.json").write_text(json.dumps(report, default=float))


def load_trained(folder: Path) -> TrainedSplats:
    """Reads the output of `save_trained`."""
    with intact(folder / "arrays.npz"), np.load(folder / "arrays.npz", allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
        head = SemanticHead(arrays.pop("weight"), arrays.pop("bias"))
        parts = {name.partition(".")[2]: arrays.pop(name) for name in list(arrays) if name.startswith("evidence.")}
        evidence = Evidence(**parts) if parts else None
        gaussians = Gaussians(**arrays)
    with intact(folder / "report.json"):
        report = json.loads((folder / "report.json").read_text())
        photometric = {name: tuple(row) for name, row in report["photometric"].items()}
        held_out, warnings = tuple(report["held_out"]), tuple(report["warnings"])
        return TrainedSplats(gaussians, head, report["quality"], held_out, evidence, photometric, warnings)


_TRADEOFFS = "tradeoffs.json"


def _capture(job: Job, folder: Path, progress: Progress) -> None:
    files = ProgressFiles(job, "capture", with_time_left(progress, "capture", job_time(job)))
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
    report = with_time_left(progress, "perception", job_time(job, capture, len(job.options.labels)))
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
    known = job_time(job, capture, len(labelling.dictionary), plan.settings)
    report = with_time_left(progress, "training", known)
    files = ProgressFiles(job, "training", with_tradeoffs(report, _tradeoffs(job)))
    settings = job.settings.model_copy(update={"training": plan.settings})
    drafts, views = Drafts(job, files), early_views(capture, labelling)

    def draft(splats: TrainedSplats, share: float) -> None:
        drafts.of_training(splats, capture, labelling, views, settings, share)

    watch = TrainingWatch(files.preview, finish_requested(job), draft, TRAINING_DRAFTS)
    save_trained(train_scene(capture, labelling, settings, files.progress, checkpoint_folder(job), watch), folder)


def _export(job: Job, folder: Path, progress: Progress) -> None:
    export_made(job, folder, lambda: _assemble(job, folder, progress))


def _assemble(job: Job, folder: Path, progress: Progress) -> None:
    capture, labelling = load_capture(job.result("capture")), load_labelling(job.result("perception"))
    trained = load_trained(job.result("training"))
    seconds = {stage: stage_seconds(job, stage) for stage in ("capture", "perception", "training")}
    asked_s = job.options.time_budget_s
    tradeoffs = (*_tradeoffs(job), *clock_tradeoff(job.settings.training, asked_s, trained.quality))
    plan_facts = SceneFacts(preset=job.options.preset, tradeoffs=tradeoffs, time_asked_s=asked_s)
    settings = job.settings.model_copy(update={"training": stored_plan(job).settings})
    progress = with_time_left(progress, "export", job_time(job, capture, len(labelling.dictionary)))
    scene = assemble_scene(trained, labelling, capture, settings, plan_facts, seconds, progress)
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
