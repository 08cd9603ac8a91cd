"""Photos that join a finished scene, against a scene that was trained with all of them from the start.

    python -m benchmarks.things.joined [NAME ...] [--split test] [--photos 5] [--hidden SHARE] [--iterations 1500]
        [--keep FOLDER]

NAME is `sample` (the demo's), `tabletop` or `plush` (without a truth) of FASTSPLAT_TEST_DATA. The photos that join are
the training views nearest to the first measured view, so that the scene of the others knows that side least; with
`--hidden .4` the others are cropped so that none shows any of .4 of the points, those farthest to that side. They join
by the product's own path: placed by localization, without a word of where they were taken, compared with the scene, and
put into it by the stages of the job "train more", with its own number of steps. `anew` is trained on all views, with
the poses of the data set, for as many steps as `before` and the joining together. Of each of the three:

  psnr_near, psnr_far: of the measured views whose nearest camera is a joined photo's, and of the others;
  things_recall_50, things_precision, clicks_miou, things_mean_iou: as by `benchmarks.things`;
  hidden: by what only the joined photos show, name and IoU of the thing that fits it best, over all measured views.

Of the joining: seconds and CPU seconds of `landmarks` (once a version), `placing`, `looking` (once more, alone; the
same looking is part of `training`), `training`, and `merging` (things, codes and files); Gaussians `born`, those that
photos `changed`, whether all others are `same` to the bit, and where poses lie off those of the data set.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.provenance import begin, chosen_on, parser_of, provenance, write_json
from benchmarks.rooms.__main__ import with_things
from benchmarks.splits import add_split, results_file
from benchmarks.things.__main__ import discovery_data
from benchmarks.things.cropped import cropped, hidden_labels
from benchmarks.things.discovered import settings_by_steps, timed, trained_scene
from fastsplat.service.application.answering.landmark_cache import photos_of
from fastsplat.service.application.answering.localized_photos import LocalizedPictures, localized_photos
from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.capture.formats.kept_capture import kept_lenses
from fastsplat.service.capture.photos.scene_photos import photo_folder, write_observed_photos, write_photos
from fastsplat.service.capture.settings import PhotoSettings
from fastsplat.service.capture.types import Capture, View
from fastsplat.service.capture.uploads.sent_photos import SparePhotoDecoder
from fastsplat.service.common.progress import silent
from fastsplat.service.common.radial_lens import middle_lens
from fastsplat.service.evaluation.datasets.training import subset
from fastsplat.service.evaluation.datasets.types import Dataset, TrueView
from fastsplat.service.evaluation.scene_evaluation import evaluate_scene
from fastsplat.service.evaluation.validation_split import validation_names
from fastsplat.service.joined_photos import joined_views, joining_photos
from fastsplat.service.joined_things import look_at_joined
from fastsplat.service.localization.landmarks import find_landmarks
from fastsplat.service.perception.labelling import label_capture
from fastsplat.service.perception.labelling_files import load_labelling, save_labelling
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.query.drawing.scene_renderer import Renderer
from fastsplat.service.query.language.embeddings import embed_labels
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.scene_files import read_scene, write_scene
from fastsplat.service.scene.types import Scene, SemanticHead
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.blending import thing_map
from fastsplat.service.splatting.quality import psnr
from fastsplat.workers.protocol import Job
from fastsplat.workers.train_more_stages import STAGES
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.observation_messages import Observation, ObservedPhoto
from fastsplat_contract.operations import SceneOptions

_NAMES = ("sample", "tabletop", "plush")
_FIGURES = ("things_recall_50", "things_precision", "clicks_miou")
_ARRAYS = ("means", "quats", "log_scales", "logit_opacities", "sh", "codes")
_OBSERVED = "joining"


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("names", nargs="*", choices=[*_NAMES, []], default=[])
    parser.add_argument("--photos", type=int, default=5)
    parser.add_argument("--hidden", type=float, default=0.0, help="share of the points that only these photos show")
    parser.add_argument("--iterations", type=int, default=1500)
    parser.add_argument("--gaussians", type=int, default=20_000)
    parser.add_argument(
        "--keep", type=Path, default=Path(".bench-joined"), help="folder of captures and trained scenes"
    )
    add_split(parser)
    options = parser.parse_args()
    out = results_file("joined", options.split)
    for name in options.names or _NAMES:
        start, title = begin(), f"{name} widened" if options.hidden else name
        row = _row(name, options.keep.resolve() / options.split / title.replace(" ", "-"), options)
        about = provenance(start, settings=options, chosen_on=chosen_on(name, options.split))
        document = json.loads(out.read_text()) if out.is_file() else {"rows": {}}
        document["rows"][title] = {**row, "provenance": about}
        write_json(out, document)
        print(f"{title}: {json.dumps(row)}", flush=True)


def _row(name: str, folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    folder.mkdir(parents=True, exist_ok=True)
    settings = settings_by_steps(options.iterations, options.gaussians)
    with tempfile.TemporaryDirectory(prefix="fastsplat-") as work:
        dataset, capture = discovery_data(name, Path(work), folder.parent, settings.capture, options.split)
        measured, capture = _measured(dataset, capture)
        new = _nearest(capture, measured[0], options.photos)
        first = cropped(capture, new, options.hidden, Path(work)) if options.hidden else capture
        few = subset(first, tuple(view.posed.name for view in first.views if view.posed.name not in new))
        before = _found(few, folder / "before", settings)
        views = [view for view in capture.views if view.posed.name in new]
        version, row = _observed(before, few, views, folder / "version", settings)
        joined, merged = _joined(version, folder / "job", settings)
        whole = replace(capture, views=(*few.views, *views), given_labels=None)
        hidden = hidden_labels(first, new) if dataset is not None else []
        steps = options.iterations + merged["steps"]
        anew = _found(whole, folder / f"anew-{steps}", settings_by_steps(steps, options.gaussians))
        row = {"views": len(few.views), "photos": len(new), **row, **merged}
        for title, scene in (("before", before), ("joined", joined), ("anew", anew)):
            row[title] = _figures(scene, measured, whole, new, dataset, hidden, settings)
        return row


def _measured(dataset: Dataset | None, capture: Capture) -> tuple[Sequence[TrueView], Capture]:
    """The views to measure by, and the capture without them; of a set without a truth some of its photos."""
    if dataset is not None:
        return sorted((view for view in dataset.test if view.posed), key=lambda view: view.name), capture
    names = [view.posed.name for view in capture.views]
    out = validation_names(names, [view.posed.world_from_camera for view in capture.views])
    views = [TrueView(view.posed.name, view.posed, load_rgb(view.image_path)) for view in capture.views]
    rest = subset(capture, tuple(name for name in names if name not in out))
    return [view for view in views if view.name in out], rest


def _nearest(capture: Capture, measured: TrueView, count: int) -> set[str]:
    assert measured.posed is not None
    middle = measured.posed.world_from_camera[:3, 3]
    away = {v.posed.name: float(np.linalg.norm(v.posed.world_from_camera[:3, 3] - middle)) for v in capture.views}
    return set(sorted(away, key=away.__getitem__)[:count])


def _found(capture: Capture, folder: Path, settings: Settings) -> Scene:
    """A scene of a capture with the things that a job finds in its photos; what lies in `folder` is not made again."""
    capture = replace(capture, given_labels=None)
    scene = trained_scene(folder / "scene", capture, settings)
    if not (folder / "looked").is_dir():
        looked = label_capture(capture, settings.perception, settings.models, (), silent, masks=True)
        save_labelling(looked, folder / "looked")
    looked = load_labelling(folder / "looked")
    encoder = open_text_encoder(settings.perception.text_encoder, settings.models)
    scene = replace(
        scene,
        dictionary=looked.dictionary,
        head=SemanticHead.unlearnt(len(looked.dictionary), scene.gaussians.codes.shape[1]),
        label_embeddings=embed_labels(looked.dictionary, encoder, settings.query.templates),
        text_encoder=(encoder.name, encoder.sha256),
        label_templates=settings.query.templates,
        quality={**scene.quality, "label_source": "detected"},
    )
    return with_things(scene, capture, looked, settings)


def _observed(
    scene: Scene, capture: Capture, views: Sequence[View], version: Path, settings: Settings
) -> tuple[Path, dict[str, Any]]:
    """The folder of a version with an observation of the views, as the service keeps it, and what placing them took."""
    shutil.rmtree(version, ignore_errors=True)
    version.mkdir()
    write_photos(capture, version, PhotoSettings())
    (photo_folder(version) / "labels.json").write_text("[]")
    index = SceneIndex(scene, open_text_encoder(settings.perception.text_encoder, settings.models), settings.query)
    side = settings.localization.max_side
    photos = photos_of(scene.cameras, version, side)
    lens = middle_lens(kept_lenses(photo_folder(version)))
    landmarks, found = timed(lambda: find_landmarks(photos, index.geometry, lens))

    def locate() -> LocalizedPictures:
        decoder = SparePhotoDecoder(settings.capture)
        sent = decoder.decode([view.image_path.read_bytes() for view in views], side)
        decoder.close()
        return localized_photos(index, landmarks, sent, [None] * len(sent), [], "1")

    located, placing = timed(locate)
    answers = located.answer.photos
    there = {number: photo.camera for number, photo in enumerate(answers) if photo.camera is not None}
    observed = [
        ObservedPhoto(f"{_OBSERVED}/{place}", camera, answers[number].differences)
        for place, (number, camera) in enumerate(there.items())
    ]
    now = datetime.now(UTC)
    kept = Observation("", _OBSERVED, now, "received", tuple(observed), (), located.answer.changes, (), False, "")
    pictures = [picture for number in there if (picture := located.pictures[number]) is not None]
    write_observed_photos(pictures, version, _OBSERVED, PhotoSettings())
    write_scene(replace(scene, observations=(kept,)), version / "artefact")
    off = [_off(views[number].posed, camera) for number, camera in there.items()]
    size = float(np.ptp(np.stack([view.posed.world_from_camera[:3, 3] for view in capture.views]), axis=0).max())
    return version, {
        **{f"landmarks_{key}": value for key, value in found.items()},
        **{f"placing_{key}": value for key, value in placing.items()},
        "placed": len(there),
        "changes_told": len(located.answer.changes),
        "pose_off_percent": [round(100 * each / size, 3) for each in off],
    }


def _off(truth: PosedCamera, told: PosedCamera) -> float:
    return float(np.linalg.norm(truth.world_from_camera[:3, 3] - told.world_from_camera[:3, 3]))


def _joined(version: Path, folder: Path, settings: Settings) -> tuple[Scene, dict[str, Any]]:
    """The scene after the photos of its observation have joined, by the stages of the job, and what that took."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "masks").mkdir(parents=True)
    before = read_scene(version / "artefact")
    views = joined_views(joining_photos(before, version, (_OBSERVED,)), folder / "masks")
    stages = {"looking": timed(lambda: look_at_joined(before, views, settings, silent))[1]}
    order = {"observations": [_OBSERVED], "version": "1"}
    job = Job("joined", 1, version, folder, SceneOptions(), settings, order=order, version="1", base=(version, "1"))
    for stage in ("training", "merging"):
        job.result(stage).mkdir()
        stages[stage] = timed(partial(STAGES[stage], job, job.result(stage), silent))[1]
    after = read_scene(job.result("merging") / "artefact")
    result = json.loads((job.result("merging") / "summary.json").read_text())["result"]
    with np.load(job.result("training") / "rows.npz") as rows:
        changed = rows["changed"]
    count = len(before.gaussians)
    kept = np.flatnonzero(~changed[:count])
    same = all(
        np.array_equal(getattr(before.gaussians, each)[kept], getattr(after.gaussians, each)[kept]) for each in _ARRAYS
    )
    assert before.things is not None and after.things is not None
    known = {thing.id for thing in before.things.table}
    new = [thing for thing in after.things.table if thing.id not in known]
    return after, {
        **{f"{stage}_{key}": value for stage, seconds in stages.items() for key, value in seconds.items()},
        "joined_photos": len(result["joined"]),
        "left_out": list(result["left_out"]),
        "steps": result["steps"],
        "gaussians": count,
        "changed": int(changed[:count].sum()),
        "born": len(after.gaussians) - count,
        "same": same,
        "new_things": [thing.name for thing in new],
    }


def _figures(
    scene: Scene,
    measured: Sequence[TrueView],
    whole: Capture,
    new: set[str],
    dataset: Dataset | None,
    hidden: Sequence[int],
    settings: Settings,
) -> dict[str, Any]:
    renderer = Renderer(scene, settings.query)
    values: dict[bool, list[float]] = {True: [], False: []}
    for view in measured:
        assert view.posed is not None and view.rgb is not None
        image = torch.from_numpy(renderer.colors(view.posed).astype(np.float32) / 255)
        value = float(psnr(image, torch.from_numpy(view.rgb.astype(np.float32) / 255)))
        values[bool(_nearest(whole, view, 1) & new)].append(value)
    figures: dict[str, Any] = {
        f"psnr_{side}": round(float(np.mean(each)), 3) if each else None
        for side, each in (("near", values[True]), ("far", values[False]))
    }
    figures |= {"near": len(values[True]), "far": len(values[False])}
    if dataset is None:
        return figures
    index = SceneIndex(scene, open_text_encoder(settings.perception.text_encoder, settings.models), settings.query)
    report = evaluate_scene(index, dataset, samples=0)
    told = {**{name: report.value(name) for name in _FIGURES}, "things_mean_iou": report.details["things_mean_iou"]}
    figures |= {name: round(value, 4) for name, value in told.items() if value is not None}
    labels = [entry.label for entry in dataset.dictionary.entries]
    return figures | {"hidden": {labels[each - 1]: _best(scene, measured, each) for each in hidden}}


def _best(scene: Scene, measured: Sequence[TrueView], label: int) -> tuple[str, float]:
    """Name and IoU of the thing that fits best what has this label, over all measured views."""
    assert scene.things is not None
    maps = [(thing_map(scene, view.posed), view.labels == label) for view in measured if view.posed is not None]
    shown = np.concatenate([drawn.ravel() for drawn, _ in maps])
    truth = np.concatenate([np.asarray(mask).ravel() for _, mask in maps])
    best, name = 0.0, ""
    for thing in scene.things.table:
        own = shown == thing.id
        overlap = float((truth & own).sum() / max(1, (truth | own).sum()))
        if overlap > best:
            best, name = overlap, thing.name
    return name, round(best, 4)


if __name__ == "__main__":
    _main()
