"""The stages of a job that trains a finished scene further: the training of the version that was ordered, and its
result put into the version of now."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fastsplat.service.capture.photos.scene_photos import share_photos
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.scene.alignment import alignment_to_json
from fastsplat.service.scene.ply import write_ply
from fastsplat.service.scene.scaling import scaling_to_json
from fastsplat.service.scene.scene_files import read_scene, write_scene
from fastsplat.service.scene.types import Scene
from fastsplat.service.splatting.continuation import Continued
from fastsplat.service.splatting.previews import TrainingWatch
from fastsplat.service.train_more import capture_of, merged_scene, train_further
from fastsplat.workers.look_again_stages import content_of
from fastsplat.workers.progress_files import ProgressFiles, finish_requested
from fastsplat.workers.protocol import Job, Stage
from fastsplat.workers.results import checkpoint_folder, intact
from fastsplat.workers.trained_files import load_trained, save_trained
from fastsplat_contract.json_codec import from_plain, to_plain
from fastsplat_contract.train_more_messages import TrainMoreIn, TrainMoreResult

_ORIGINS = "origins.npy"


def _train(job: Job, folder: Path, progress: Progress) -> None:
    """Stage "training" of a job that trains a finished scene further."""
    assert job.base is not None
    order = from_plain(TrainMoreIn, {name: value for name, value in job.order.items() if name != "version"})
    scene = read_scene(job.base[0] / "artefact")
    scratch = job.folder / "masks"
    scratch.mkdir(exist_ok=True)
    capture = capture_of(scene, job.base[0], scratch)
    files = ProgressFiles(job, "training", progress)
    continued = train_further(
        scene,
        capture,
        job.settings,
        files.progress,
        checkpoint_folder(job),
        seconds=order.seconds,
        steps=order.steps,
        preset=order.preset,
        watch=TrainingWatch(files.preview, finish_requested(job)),
    )
    save_trained(continued.trained, folder)
    np.save(folder / _ORIGINS, continued.origins)


def _merge(job: Job, folder: Path, progress: Progress) -> None:
    """Stage "merging": the current version with what was trained, as a folder to be published; where that contradicts
    what was edited meanwhile, the version that was trained, to stand beside the current one.

    `summary.json` says of which version it was made, and what to tell the caller.
    """
    assert job.base is not None
    result = job.result("training")
    trained = load_trained(result)
    with intact(result / _ORIGINS):
        continued = Continued(trained, np.load(result / _ORIGINS, allow_pickle=False))
    base = read_scene(job.base[0] / "artefact")
    source, parent = job.upload, job.version
    scene = merged_scene(read_scene(source / "artefact"), base, continued)
    beside = scene is None
    if scene is None:
        source, parent = job.base
        scene = merged_scene(base, base, continued)
        assert scene is not None
    progress(ProgressEvent("merging", 0.2, "writing the scene"))
    write_scene(scene, folder / "artefact")
    progress(ProgressEvent("merging", 0.7, "writing the PLY file"))
    write_ply(scene.gaussians, folder / "scene.ply")
    share_photos(source, folder)
    made = _result(base, continued, job.base[1])
    summary = {
        "parent": parent,
        "beside": beside,
        **content_of(scene),
        "quality": _json(scene),
        "scaling": scaling_to_json(scene.scaling),
        "alignment": alignment_to_json(scene.alignment),
        "result": to_plain(replace(made, current=not beside)),
    }
    (folder / "summary.json").write_text(json.dumps(summary))


STAGES: Mapping[str, Stage] = {"training": _train, "merging": _merge}


def _result(base: Scene, continued: Continued, trained_from: str) -> TrainMoreResult:
    figures = continued.trained.quality
    return TrainMoreResult(
        version="",
        trained_from=trained_from,
        current=True,
        steps=int(figures["iterations"]),
        seconds=float(figures["train_seconds"]),
        gaussians_before=len(base.gaussians),
        gaussians=len(continued.trained.gaussians),
        psnr_before=figures.get("psnr_before"),
        psnr=figures.get("psnr"),
    )


def _json(scene: Scene) -> dict[str, Any]:
    return dict(json.loads(json.dumps(dict(scene.quality), default=float)))
