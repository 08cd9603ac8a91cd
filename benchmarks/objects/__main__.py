"""Everything in the room is an object: what discovery without a vocabulary reaches, and what it costs.

    python -m benchmarks.objects [NAME ...] [--split test] [--iterations 2500] [--keep FOLDER] [--quality-only]

NAME is `sample` (the demo's), or a folder of FASTSPLAT_TEST_DATA: `tabletop`, `skull` (masks of one object), and
`kitchen` and `plush`, which have no truth. Of the last three a contact sheet is drawn. Scenes are trained on the
training views without any label, bounded by iterations, so that a busy machine changes seconds only; a trained scene
that lies in `--keep` is not trained again. `--quality-only` leaves out all seconds, which a busy machine distorts.
`looking` is the detector and the segmenter on every view, which a job does while it labels them, `grouping` all that
follows training. Rules are chosen by views of the training split, which are measured by default; `--split test`
measures the test views. Every row replaces itself in benchmarks/results/objects.json, or objects_validation.json.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.evaluation.datasets.dataset import Dataset
from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.evaluation.datasets.training import training_capture
from benchmarks.evaluation.scene_evaluation import evaluate_scene
from benchmarks.evaluation.validation_split import Split
from benchmarks.objects.discovered import draw_sheet, settings_by_steps, timed, trained_scene
from benchmarks.provenance import RESULTS, ROOT, Start, begin, chosen_on, parser_of, provenance, write_json
from benchmarks.splits import add_split, results_file
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.capture_files import load_capture
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import silent
from fastsplat.service.instances.scene_objects import find_scene_objects
from fastsplat.service.jobs.create_scene import capture_folder
from fastsplat.service.perception.label_maps.capture_masks import propose_capture_masks
from fastsplat.service.perception.results import Labelling
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Scene, SemanticHead
from fastsplat.service.settings import Settings

_MASK_LABELS = {"skull": "skull"}
_WITHOUT_TRUTH = ("kitchen", "plush")
_NAMES = ("sample", "tabletop", "skull", *_WITHOUT_TRUTH)
_FIGURES = ("objects_recall_50", "objects_recall_75", "objects_precision", "clicks_miou")
_DRAWN = ("skull", *_WITHOUT_TRUTH)


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("names", nargs="*", choices=[*_NAMES, []], default=[])
    parser.add_argument("--iterations", type=int, default=2500)
    parser.add_argument("--gaussians", type=int, default=30_000)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--quality-only", action="store_true")
    add_split(parser)
    options = parser.parse_args()
    settings = settings_by_steps(options.iterations, options.gaussians)
    for name in options.names or _NAMES:
        with tempfile.TemporaryDirectory(prefix="fastsplat-") as work:
            keep = (options.keep or Path(work) / "scenes") / options.split
            _measure(name, settings, keep, Path(work), options)


def _measure(name: str, settings: Settings, keep: Path, work: Path, options: argparse.Namespace) -> None:
    start = begin()
    dataset, capture = discovery_data(name, work, keep, settings.capture, options.split)
    scene = trained_scene(keep / name, capture, settings)
    masks, looking = timed(lambda: propose_capture_masks(capture.views, settings.perception, settings.models))
    unlabeled, seen = Labelling(Dictionary(()), ()), [view_masks for view_masks in masks if view_masks is not None]
    (objects, gaussians), grouping = timed(
        lambda: find_scene_objects(
            scene.gaussians, capture, unlabeled, masks, settings.discovery, training=settings.training
        )
    )
    head = SemanticHead.unlearnt(len(scene.dictionary), gaussians.codes.shape[1])
    with_objects = replace(scene, gaussians=gaussians, head=head, objects=objects)
    row: dict[str, Any] = {
        "views": len(seen),
        "prompts": sum(view_masks.prompts for view_masks in seen),
        "proposals": sum(len(view_masks) for view_masks in seen),
        "objects": len(objects.table),
        "gaussians": len(scene.gaussians),
        **{f"looking_{key}": value for key, value in looking.items()},
        **{f"grouping_{key}": value for key, value in grouping.items()},
        **(_figures(with_objects, dataset, settings) if dataset is not None else {}),
    }
    if options.quality_only:
        row = {key: value for key, value in row.items() if not key.endswith(("_seconds", "_ms"))}
    _write(name, row, start, options)
    if name in _DRAWN and options.split == "test":
        draw_sheet(with_objects, capture, RESULTS / f"objects_{name}.jpg")


def discovery_data(
    name: str, work: Path, keep: Path, settings: CaptureSettings, split: Split
) -> tuple[Dataset | None, Capture]:
    """A set's truth, None of those that have none, and the capture of its training views.

    Args:
        name: one of those in this module's text.
        work: a folder to build captures in.
        keep: a folder for captures of sets without a truth, whose poses take minutes.
        settings: of the capture.
        split: whose views are measured.
    """
    folder = ROOT / "demo" / "sample" if name == "sample" else Path(os.environ["FASTSPLAT_TEST_DATA"]) / name
    if name in _WITHOUT_TRUTH:
        stored = keep / f"{name}-capture"
        if not stored.is_dir():
            raw = work / "raw"
            (raw / "images").mkdir(parents=True)
            for path in sorted((folder / "images").iterdir()):
                (raw / "images" / path.name).write_bytes(path.read_bytes())
            keep.mkdir(parents=True, exist_ok=True)
            capture_folder(raw, stored, settings)
        return None, load_capture(stored)
    dataset = read_dataset(folder, settings, mask_label=_MASK_LABELS.get(name, ""), split=split)
    (work / "capture").mkdir()
    return dataset, training_capture(dataset, work / "capture", settings, silent)


def _figures(scene: Scene, dataset: Dataset, settings: Settings) -> dict[str, Any]:
    encoder = open_text_encoder(settings.perception.text_encoder, settings.models)
    report = evaluate_scene(SceneIndex(scene, encoder, settings.query), dataset)
    figures = {name: report.figures[name] for name in _FIGURES}
    return {
        key: round(value, 4) if isinstance(value, float) else value
        for key, value in (figures | dict(report.details)).items()
    }


def _write(name: str, row: Mapping[str, Any], start: Start, options: argparse.Namespace) -> None:
    out = results_file("objects", options.split)
    document = json.loads(out.read_text()) if out.is_file() else {"rows": {}}
    document["rows"] = {key: value for key, value in document["rows"].items() if key in _NAMES}
    about = provenance(start, settings=options, chosen_on=chosen_on(name, options.split))
    document["rows"][name] = {**row, "provenance": about}
    write_json(out, document)
    print(f"{name}: {json.dumps(row)}", flush=True)


if __name__ == "__main__":
    _main()
