"""The four stages of a job as one trainer process runs them: files in, files out, pure functions in between."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from fastsplat.service.application.stored import camera_to_json
from fastsplat.service.capture import build_capture, load_capture
from fastsplat.service.capture.types import Capture
from fastsplat.service.common.progress import STAGES, Progress, ProgressEvent
from fastsplat.service.perception import label_capture, load_labelling, save_labelling
from fastsplat.service.perception.text import open_text_encoder
from fastsplat.service.perception.types import Labelling
from fastsplat.service.query import embed_labels
from fastsplat.service.query.fields import label_field
from fastsplat.service.scene import Evidence, Gaussians, Scene, SemanticHead, write_ply, write_scene
from fastsplat.service.splatting.train import train
from fastsplat.service.splatting.types import TrainedSplats
from fastsplat.workers.budget import kept_plan, plan_perception, plan_training
from fastsplat.workers.protocol import Job, Stages
from fastsplat.workers.results import checkpoint_folder, stage_seconds

_GIVEN_UP = "given_up.json"


def _capture(job: Job, folder: Path, progress: Progress) -> None:
    build_capture(job.upload, folder, job.settings.capture, progress)


def _perception(job: Job, folder: Path, progress: Progress) -> None:
    started = time.monotonic()
    capture = load_capture(job.result("capture"))
    settings, given_up = plan_perception(job, capture, started, progress)
    labelling = label_capture(capture, settings, job.settings.models, job.options.labels, progress)
    save_labelling(labelling, folder)
    (folder / _GIVEN_UP).write_text(json.dumps(given_up))


def _training(job: Job, folder: Path, progress: Progress) -> None:
    started = time.monotonic()
    capture, labelling = load_capture(job.result("capture")), load_labelling(job.result("perception"))
    settings = plan_training(job, capture, len(labelling.dictionary), started).settings
    told = _telling(_given_up(job), progress)
    trained = train(capture, labelling, settings, told, checkpoint_dir=checkpoint_folder(job))
    save_trained(trained, folder)


def _export(job: Job, folder: Path, progress: Progress) -> None:
    capture, labelling = load_capture(job.result("capture")), load_labelling(job.result("perception"))
    trained = load_trained(job.result("training"))
    encoder = open_text_encoder(job.settings.perception.text_encoder, job.settings.models)
    progress(ProgressEvent("export", 0.1, f"embedding {len(labelling.dictionary)} labels"))
    templates = job.settings.query.templates
    scene = Scene(
        gaussians=trained.gaussians,
        head=trained.head,
        dictionary=labelling.dictionary,
        label_embeddings=embed_labels(labelling.dictionary, encoder, templates),
        text_encoder=(encoder.name, encoder.sha256),
        cameras=tuple(view.posed for view in capture.views),
        scale=capture.scale,
        training=kept_plan(job).settings.model_dump(mode="json"),
        quality=_quality(job, capture, trained),
        label_templates=templates,
        evidence=trained.evidence,
        label_mode=trained.label_mode,
    )
    progress(ProgressEvent("export", 0.4, "writing the scene"))
    write_scene(scene, folder / "artefact")
    progress(ProgressEvent("export", 0.7, "writing the PLY file"))
    write_ply(scene.gaussians, folder / "scene.ply")
    (folder / "summary.json").write_text(json.dumps(_summary(scene, labelling)))


STAGES_OF_THE_PRODUCT = Stages(_capture, _perception, _training, _export)


def save_trained(trained: TrainedSplats, folder: Path) -> None:
    """Keep a training result for the export stage."""
    arrays = {**vars(trained.gaussians), "weight": trained.head.weight, "bias": trained.head.bias}
    if trained.evidence is not None:
        arrays |= {f"evidence.{name}": array for name, array in vars(trained.evidence).items()}
    np.savez(folder / "arrays.npz", **arrays)
    report = {"quality": dict(trained.quality), "held_out": list(trained.held_out)}
    (folder / "report.json").write_text(json.dumps(report, default=float))


def load_trained(folder: Path) -> TrainedSplats:
    """Back from `save_trained`, exactly."""
    with np.load(folder / "arrays.npz", allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    head = SemanticHead(arrays.pop("weight"), arrays.pop("bias"))
    parts = {name.partition(".")[2]: arrays.pop(name) for name in list(arrays) if name.startswith("evidence.")}
    evidence = Evidence(**parts) if parts else None
    report = json.loads((folder / "report.json").read_text())
    return TrainedSplats(Gaussians(**arrays), head, report["quality"], tuple(report["held_out"]), evidence)


def _given_up(job: Job) -> tuple[str, ...]:
    """What perception and training gave up to end in time, in words."""
    path = job.result("perception") / _GIVEN_UP
    seen = json.loads(path.read_text()) if path.exists() else ()
    return (*seen, *kept_plan(job).given_up)


def _telling(given_up: tuple[str, ...], progress: Progress) -> Progress:
    """Every message says what was given up."""
    if not given_up:
        return progress
    suffix = f" (to end in time: {', '.join(given_up)})"
    return lambda event: progress(replace(event, message=event.message + suffix))


def _quality(job: Job, capture: Capture, trained: TrainedSplats) -> dict[str, Any]:
    report = capture.report
    return {
        **trained.quality,
        "preset": job.options.preset,
        "given_up": list(_given_up(job)),
        "gaussians": len(trained.gaussians),
        "held_out_views": list(trained.held_out),
        "images": report.images,
        "registered": len(capture.views),
        "unregistered": list(report.unregistered),
        "source": report.source,
        "warnings": list(report.warnings),
        "mean_reprojection_error_px": report.mean_reprojection_error_px,
        "stage_seconds": {stage: stage_seconds(job, stage) for stage in STAGES if stage != "export"},
    }


def _summary(scene: Scene, labelling: Labelling) -> dict[str, Any]:
    classes = label_field(scene).classes
    counts = np.bincount(classes, minlength=len(scene.dictionary) + 1)
    rows = [
        {"label_id": number, **asdict(entry), "gaussian_count": int(counts[number])}
        for number, entry in enumerate(labelling.dictionary.entries, start=1)
    ]
    return {
        "gaussians": len(scene.gaussians),
        "scale": scene.scale,
        "dictionary": rows,
        "cameras": [camera_to_json(posed) for posed in scene.cameras],
        "quality": dict(scene.quality),
    }
