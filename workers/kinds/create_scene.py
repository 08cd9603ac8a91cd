"""Stages of a job that makes a scene: file input and output around `service.jobs.create_scene`."""

from __future__ import annotations

import itertools
import json
import secrets
import shutil
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.capture_files import load_capture
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.photos.scene_photos import share_photos, write_photos
from fastsplat.service.capture.sfm.placed_cameras import placed_of
from fastsplat.service.common.files import atomic_file, link_or_copy
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.jobs.create_scene import assemble_scene, build_views, label_views, train_scene
from fastsplat.service.jobs.drafts import DraftVersion, carry_edits, first_draft, training_draft
from fastsplat.service.jobs.new_versions import content_of
from fastsplat.service.perception.label_maps.early_look import EARLY_VIEWS, covering_order
from fastsplat.service.perception.label_maps.labelling_files import load_labelling, save_labelling
from fastsplat.service.perception.results import Labelling
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.planning.cost_model import Speed, scene_size
from fastsplat.service.planning.job_time import (
    PACED,
    JobTime,
    job_seconds,
    photo_set,
    placed_seconds,
    with_time_left,
)
from fastsplat.service.planning.machine import machine_speed
from fastsplat.service.planning.time_budget import StagePlan, clock_tradeoff, plan_training, with_tradeoffs
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Evidence, Gaussians, Scene, SceneFacts, SemanticHead
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.scene.formats.ply import write_ply
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training.previews import TrainingWatch
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.store.blobs.blobs import remove
from fastsplat.service.store.rows.codec import camera_to_json
from fastsplat.workers.job.made_scenes import CARRIED, DRAFTS, EDITS, SUMMARY, read_edited
from fastsplat.workers.job.protocol import Job, Stage
from fastsplat.workers.job.results import PHOTOS, RESULT_FILES, SPARE_SUFFIX, checkpoint_folder, intact, stage_seconds
from fastsplat.workers.kinds.progress_files import ProgressFiles, finish_requested
from fastsplat_contract.codec.json_codec import from_plain, to_plain
from fastsplat_contract.errors import CancelledError, ConflictError, FastSplatError, InvalidInputError, NotFoundError
from fastsplat_contract.jobs.job_watching import Provisional
from fastsplat_contract.messages.scenes import Edit

_PLAN = "plan.json"

_TRAINING_DRAFTS = (0.25,)
"""Training progress, 0..1, at which drafts are due."""

_OF_EDIT = {field.name for field in fields(Edit)}
"""Fields of an edit; version rows also hold results of prompts."""


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
        drafts.publish("perception", lambda: first_draft(capture, labelling, views, job.settings))

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
    with suppress(FileNotFoundError):  # without a time budget
        shutil.copy(job.folder / _PLAN, folder)  # for an export on another machine
    known = job_time(job, capture, len(labelling.dictionary), plan.settings)
    report = with_time_left(progress, "training", known)
    files = ProgressFiles(job, "training", with_tradeoffs(report, _tradeoffs(job)))
    settings = job.settings.model_copy(update={"training": plan.settings})
    drafts, first = Drafts(job, files), [number for number, masks in enumerate(labelling.masks) if masks is not None]
    views = covering_order(capture, first or range(len(capture.views)))[:EARLY_VIEWS]  # those masked first

    def draft(splats: TrainedSplats, share: float) -> None:
        provisional = Provisional("training", round(share, 3))
        drafts.publish("training", lambda: training_draft(splats, capture, labelling, views, settings, provisional))

    watch = TrainingWatch(files.preview, finish_requested(job), draft, _TRAINING_DRAFTS)
    save_trained(train_scene(capture, labelling, settings, files.progress, checkpoint_folder(job), watch), folder)


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
    "capture": _capture, "perception": _perception, "training": _training,
    "export": lambda job, folder, progress: export_made(job, folder, partial(_assemble, job, folder, progress)),
}  # fmt: skip


def _tradeoffs(job: Job) -> tuple[str, ...]:
    """Lists reductions of perception and training due to the time budget."""
    path = job.result("perception") / _TRADEOFFS
    with intact(path):
        of_perception = json.loads(path.read_text()) if path.exists() else ()
    return (*of_perception, *stored_plan(job).tradeoffs)


def _job_speed(job: Job) -> Speed:
    """The speed of the machine that asked first for this job."""
    path = job.folder / "speed.json"
    if path.exists():
        return Speed(**json.loads(path.read_text()))
    speed = machine_speed(job.settings.training.backend)
    with atomic_file(path) as part:
        part.write_text(json.dumps(asdict(speed)))
    return speed


def job_time(
    job: Job, capture: Capture | None = None, labels: int = 0, planned: TrainingSettings | None = None
) -> JobTime:
    """Predicts a job's time by its finished stages; without a `capture`, of photos without poses alone."""
    settings, training = job.settings, planned or job.settings.training
    try:
        photos = photo_set(read_manifest(job.upload)[0])
    except (OSError, InvalidInputError, NotFoundError):  # files that show people go before the training
        photos = None

    def seconds(speed: Speed) -> Mapping[str, float]:
        before = {} if photos is None else job_seconds(photos, settings, speed)
        return before if capture is None else {**before, **placed_seconds(capture, settings, training, speed, labels)}

    speed = _job_speed(job)
    expected = seconds(speed)
    done = [stage for stage in PACED if stage in expected and job.result(stage).is_dir()]
    ran = tuple((expected[stage], stage_seconds(job, stage), 1.0) for stage in done)
    run = None if capture is None or capture.splat is not None else (training, scene_size(capture, labels))
    return JobTime(seconds, speed, ran, run, job.options.time_budget_s)


def make_plan(job: Job, capture: Capture, labels: int, started: float) -> StagePlan[TrainingSettings]:
    """Reads the plan of an earlier attempt, or stores a new one; `started` is of `time.monotonic()`."""
    budget = job.options.time_budget_s
    if budget is not None and not (job.folder / _PLAN).exists():
        spent, speed = stage_seconds(job, "perception") + time.monotonic() - started, job_time(job, capture).speed_now
        plan = plan_training(capture, job.settings, labels, budget, spent_s=spent, speed_of=lambda _: speed)
        stored = {"settings": plan.settings.model_dump(mode="json"), "tradeoffs": plan.tradeoffs}
        with suppress(FileExistsError), atomic_file(job.folder / _PLAN, replace=False) as part:  # another was faster
            part.write_text(json.dumps(stored))
    return stored_plan(job)


def stored_plan(job: Job) -> StagePlan[TrainingSettings]:
    """The plan that the training stage follows or followed; without a time budget that is the job's settings."""
    places = (folder / _PLAN for folder in (job.result("training"), job.folder))
    path = next((path for path in places if path.exists()), None)
    if path is None:
        return StagePlan(job.settings.training)
    with intact(path):
        stored = json.loads(path.read_text())
        return StagePlan(TrainingSettings.model_validate(stored["settings"]), tuple(stored["tradeoffs"]))


def write_made(scene: Scene, folder: Path) -> None:
    """Writes a scene for publication, without photos."""
    write_scene(scene, folder / "artefact")
    write_ply(scene.gaussians, folder / "scene.ply")
    summary = {
        **content_of(scene),
        "scale": scene.scale,
        "cameras": [camera_to_json(posed) for posed in scene.cameras],
        "quality": scene.facts.with_quality(scene.quality),
    }
    (folder / SUMMARY).write_text(json.dumps(summary))


def carry_into(job: Job, scene: Scene, folder: Path) -> Sequence[str]:
    """Repeats the newest draft's edits beside a written scene; describes those that failed."""
    edited = read_edited(job.folder / EDITS)
    if edited is None:
        _note(folder, "", (), ())
        return ()
    settings, encoder = job.settings, open_text_encoder(scene.text_encoder[0], job.settings.models)
    opened = partial(SceneIndex, encoder=encoder, settings=settings.query)
    draft, versions = opened(read_scene(Path(edited.folder) / "artefact")), []
    for version in edited.versions:
        edits = [from_plain(Edit, {name: row[name] for name in row if name in _OF_EDIT}) for row in version.edits]
        versions.append(DraftVersion(edits, opened(read_scene(Path(version.folder) / "artefact"))))
    carried = carry_edits(opened(scene), draft, versions, max_gaussians=settings.store.max_gaussians)
    rows: list[dict[str, Any]] = []
    for carried_version in carried.versions:
        before, name = edited.versions[carried_version.number], f"e{secrets.token_hex(8)}"
        place = folder / CARRIED / name
        place.mkdir(parents=True)
        write_made(carried_version.index.scene, place)
        share_photos(folder, place)
        summary = json.loads((place / SUMMARY).read_text())
        rows.append(
            {
                "version": name,
                "edits": [to_plain(edit) for edit in carried_version.edits],
                **{name: getattr(before, name) for name in ("author", "request_id", "request_digest")},
                **{name: summary[name] for name in ("gaussians", "objects", "dictionary")},
            }
        )
    _note(folder, edited.versions[-1].version, rows, carried.lost)
    return carried.lost


def _note(folder: Path, edited: str, rows: Sequence[dict[str, Any]], lost: Sequence[str]) -> None:
    summary = json.loads((folder / SUMMARY).read_text())
    (folder / SUMMARY).write_text(json.dumps({**summary, "edited": edited, "carried": rows, "lost": list(lost)}))


def export_made(job: Job, folder: Path, assemble: Callable[[], None]) -> None:
    """Runs the last stage: the scene, and the repeated edits of its newest draft.

    If only late edits are missing, the kept scene is used and `assemble`, which writes it, is skipped.
    """
    spare = job.folder / f"{folder.name.partition('.')[0]}{SPARE_SUFFIX}"
    if spare.is_dir():
        later = shutil.ignore_patterns(CARRIED, SUMMARY, *RESULT_FILES)
        shutil.copytree(spare, folder, copy_function=link_or_copy, ignore=later, dirs_exist_ok=True)
        (folder / SUMMARY).write_bytes((spare / SUMMARY).read_bytes())  # a copy, because links must not be written to
    else:
        assemble()
    if (job.folder / EDITS).exists():
        carry_into(job, read_scene(folder / "artefact"), folder)


class Drafts:
    """Publishes drafts of a stage; failures are logged and do not fail the job."""

    def __init__(self, job: Job, files: ProgressFiles) -> None:
        self._job, self._files = job, files
        self._numbers = itertools.count(1)

    def publish(self, stage: str, make: Callable[[], Scene]) -> None:
        """Writes and announces the draft that `make` returns; `CancelledError` alone ends the stage."""
        job = self._job
        name = f"{job.folder.name}-{stage}-{job.attempt}-{next(self._numbers)}"
        folder = job.folder / DRAFTS / f".{name}"
        try:
            scene = make()
            folder.mkdir(parents=True)
            write_made(scene, folder)
            if lost := carry_into(job, scene, folder):
                raise ConflictError(f"it would lose edits: {'; '.join(lost)}")  # the finished scene may accept them
            folder.rename(job.folder / DRAFTS / name)
        except CancelledError:
            raise
        except Exception as error:  # any failure: the job continues
            remove(folder)
            print(f"draft {name} is not made: {error}", file=sys.stderr, flush=True)
            if not isinstance(error, (FastSplatError, OSError)):
                traceback.print_exception(error)
            return
        assert scene.facts.draft is not None
        self._files.draft(name, scene.facts.draft)
