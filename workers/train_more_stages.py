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
from fastsplat.service.joined_photos import (
    JoiningPhotos,
    joined_views,
    joining_photos,
    keep_joined,
    with_joined,
)
from fastsplat.service.joined_things import look_at_joined, with_joined_things
from fastsplat.service.perception.labelling_files import load_labelling, save_labelling
from fastsplat.service.scene.alignment import alignment_to_json
from fastsplat.service.scene.frames import frame_of
from fastsplat.service.scene.ply import write_ply
from fastsplat.service.scene.scaling import scaling_to_json
from fastsplat.service.scene.scene_files import read_scene, write_scene
from fastsplat.service.scene.types import Scene
from fastsplat.service.splatting.continuation import Continued
from fastsplat.service.splatting.previews import TrainingWatch
from fastsplat.service.store.codec import camera_to_json
from fastsplat.service.store.records import JOINED_CAMERAS
from fastsplat.service.train_more import capture_of, merged_scene, train_further
from fastsplat.workers.look_again_stages import content_of
from fastsplat.workers.progress_files import ProgressFiles, finish_requested
from fastsplat.workers.protocol import Job, Stage
from fastsplat.workers.results import checkpoint_folder, intact
from fastsplat.workers.trained_files import load_trained, save_trained
from fastsplat_contract.json_codec import from_plain, to_plain
from fastsplat_contract.train_more_messages import TrainMoreIn, TrainMoreResult

_ROWS = "rows.npz"
_LABELS, _MASKS = "labels", "masks"
"""In the job's folder, of the photos that join."""


def _train(job: Job, folder: Path, progress: Progress) -> None:
    """Stage "training" of a job that trains a finished scene further."""
    assert job.base is not None
    order = from_plain(TrainMoreIn, {name: value for name, value in job.order.items() if name != "version"})
    scene = read_scene(job.base[0] / "artefact")
    scratch = job.folder / _MASKS
    scratch.mkdir(exist_ok=True)
    capture = capture_of(scene, job.base[0], scratch)
    joining = joining_photos(scene, job.base[0], order.observations)
    capture = replace(capture, views=(*capture.views, *joined_views(joining, scratch)))
    files = ProgressFiles(job, "training", progress)
    if joining.paths:
        _look(job, scene, joining, scratch, files.progress)
    continued = train_further(
        scene,
        capture,
        job.settings,
        files.progress,
        checkpoint_folder(job),
        joined=[posed.name for posed in joining.cameras],
        seconds=order.seconds,
        steps=order.steps,
        preset=order.preset,
        watch=TrainingWatch(files.preview, finish_requested(job)),
    )
    save_trained(continued.trained, folder)
    changed = np.ones(len(continued.origins), np.bool_) if continued.changed is None else continued.changed
    np.savez(folder / _ROWS, origins=continued.origins, changed=changed)


def _look(job: Job, scene: Scene, joining: JoiningPhotos, scratch: Path, progress: Progress) -> None:
    """What models see in the photos that join, kept in the job's folder; looked for once, whoever goes on with it."""

    def looking(event: ProgressEvent) -> None:
        progress(ProgressEvent("training", 0.0, event.message))

    if not (job.folder / _LABELS).is_dir():
        labelling = look_at_joined(scene, joined_views(joining, scratch), job.settings, looking)
        if labelling is not None:
            save_labelling(labelling, job.folder / _LABELS)


def _merge(job: Job, folder: Path, progress: Progress) -> None:
    """Stage "merging": the current version with what was trained, as a folder to be published; where that contradicts
    what was edited meanwhile, the version that was trained, to stand beside the current one.

    `summary.json` says of which version it was made, and what to tell the caller.
    """
    assert job.base is not None
    result = job.result("training")
    trained = load_trained(result)
    observations = tuple(job.order.get("observations", ()))
    with intact(result / _ROWS), np.load(result / _ROWS, allow_pickle=False) as rows:
        continued = Continued(trained, rows["origins"], rows["changed"] if observations else None)
    base = read_scene(job.base[0] / "artefact")
    source, parent = job.upload, job.version
    scene = merged_scene(read_scene(source / "artefact"), base, continued)
    beside = scene is None
    if scene is None:
        source, parent = job.base
        scene = merged_scene(base, base, continued)
        assert scene is not None
    before = len(scene.cameras)
    joining = joining_photos(base, job.base[0], observations)
    scene = _joined(scene, base, joining)
    if (job.folder / _LABELS).is_dir():
        progress(ProgressEvent("merging", 0.0, "finding things in the photos that have joined"))
        born = np.arange(len(scene.gaussians)) >= len(base.gaussians)
        placed = replace(joining, cameras=scene.cameras[before:])
        views = joined_views(placed, job.folder / _MASKS)
        assert continued.changed is not None
        labelling = load_labelling(job.folder / _LABELS)
        scene = with_joined_things(scene, views, labelling, continued.changed, born, job.settings)
    progress(ProgressEvent("merging", 0.2, "writing the scene"))
    write_scene(scene, folder / "artefact")
    progress(ProgressEvent("merging", 0.7, "writing the PLY file"))
    write_ply(scene.gaussians, folder / "scene.ply")
    share_photos(source, folder)
    if joining.paths:
        keep_joined(joining, folder, before)
    made = _result(base, continued, joining, job.base[1])
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


def _joined(scene: Scene, base: Scene, joining: JoiningPhotos) -> Scene:
    """The scene with the cameras of photos that were placed in `base`, also as the service lists them."""
    if not joining.cameras:
        return scene
    into = frame_of(scene).after(frame_of(base).inverse())
    scene = with_joined(scene, tuple(map(into.camera, joining.cameras)), joining)
    trained = frame_of(base).inverse()
    rows = [camera_to_json(trained.camera(posed)) for posed in joining.cameras]
    rows = [*scene.quality.get(JOINED_CAMERAS, ()), *rows]
    return replace(scene, quality={**scene.quality, JOINED_CAMERAS: rows})


def _result(base: Scene, continued: Continued, joining: JoiningPhotos, trained_from: str) -> TrainMoreResult:
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
        joined=tuple(posed.name for posed in joining.cameras),
        left_out=joining.left_out,
        unchanged=None if continued.changed is None else int((~continued.changed).sum()),
    )


def _json(scene: Scene) -> dict[str, Any]:
    return dict(json.loads(json.dumps(dict(scene.quality), default=float)))
