"""Twelve drawn rooms: how whole, clean and rightly named their objects are.

    python -m benchmarks.rooms [ROOM ...] [--split test] [--iterations 2500] [--keep FOLDER] [--sheets]

ROOM is a kind of room (desk, kitchen, ...) or one of its rooms (desk-1); without any, all of the split are measured.
Rooms are drawn from seeds (`drawing.py`), and what is true of them comes from the drawing: exact ids of objects and
parts, boxes, surfaces, silhouettes. Photos have a phone's faults, test views even light. Rules are chosen by the six
rooms of the validation split; `--split test` measures the six others, once.

A room whose folder lies in `--keep` is not drawn, trained or looked at again: then a trial of other rules costs
seconds. A folder holds `drawn` (the data set), `capture`, `scene` (trained without labels) and `looked` (masks and
detections of the training views). `--sheets` draws contact sheets beside the results.

  recall_50, recall_75, precision, mean_iou: discovered objects against true ones, pixels of all test views;
  clicks_miou: after each true object was clicked once and named; selected_miou: what each single click selects;
  clicks_1.3_miou: with a second click on the worst 30 %;
  surfaces_iou: of floors, walls and table tops; outside_box, outside_at_others, covered, alone_miou: see
  `figures.py`;
  names_given_right of names_given, names_stated_right of those that are no guess, names_known of names_knowable: names
  of the detector's 80 words;
  psnr, psnr_cc: of the test views, and after the best affine map of their colors.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.evaluation.datasets.dataset import Dataset
from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.evaluation.datasets.training import subset, training_capture
from benchmarks.objects.discovered import draw_sheet, settings_by_steps, timed, trained_scene
from benchmarks.provenance import RESULTS, begin, parser_of, provenance, write_json
from benchmarks.rooms.drawing import KINDS, ROOMS, write_room
from benchmarks.rooms.figures import figures_of, measured, worst_of
from benchmarks.rooms.truth import read_truth
from benchmarks.splits import results_file
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.capture_files import holds_capture, load_capture
from fastsplat.service.common.progress import silent
from fastsplat.service.instances.naming.name_models import load_name_model
from fastsplat.service.instances.scene_objects import find_scene_objects
from fastsplat.service.perception.label_maps.labelling import label_capture
from fastsplat.service.perception.label_maps.labelling_files import load_labelling, save_labelling
from fastsplat.service.perception.results import Labelling
from fastsplat.service.query.drawing.scene_renderer import Renderer
from fastsplat.service.scene.artefact.scene import Scene, SemanticHead
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.training.quality import color_corrected, psnr

_SHEET_SCALE, _SHEET_QUALITY = 0.5, 60
_CHOSEN_ON = {
    "validation": "these rooms are there to choose rules of objects by: their figures promise nothing",
    "test": "nothing was chosen on these rooms; rules of objects: on the six rooms of the validation split",
}
_NAMED = {
    "names_given_right_share": ("names_given_right", "names_given"),
    "names_stated_right_share": ("names_stated_right", "names_stated"),
    "names_known_share": ("names_known", "names_knowable"),
}


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("rooms", nargs="*", metavar="ROOM")
    parser.add_argument("--split", choices=tuple(ROOMS), default="validation", help="which six rooms")
    parser.add_argument("--iterations", type=int, default=2500)
    parser.add_argument("--gaussians", type=int, default=30_000)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--sheets", action="store_true")
    options = parser.parse_args()
    settings = settings_by_steps(options.iterations, options.gaussians)
    known = ROOMS[options.split]
    rooms = [name for name in known if not options.rooms or {name, name.split("-")[0]} & set(options.rooms)]
    unknown = [word for word in options.rooms if word not in (*known, *KINDS)]
    if unknown or not rooms:
        parser.error(f"no room of the {options.split} split: {' '.join(unknown or options.rooms)}; {' '.join(known)}")
    for name in rooms:
        with tempfile.TemporaryDirectory(prefix="fastsplat-") as work:
            start = begin()
            row = _row(name, (options.keep or Path(work)) / name, settings, options.sheets)
            about = provenance(start, settings=options, chosen_on=_CHOSEN_ON[options.split])
            _write(results_file("rooms", options.split), name, {**row, "provenance": about})


def kept_room(name: str, folder: Path, settings: Settings) -> tuple[Dataset, Capture, Scene, Labelling]:
    """A room's test views, the capture of its training views, the scene trained on them without a label, and what the
    models see in them: read from `folder`, where what is not there yet is made and stored.

    Args:
        name: of the room, see `drawing.ROOMS`.
        folder: the room's own.
        settings: of all rooms of the service.
    """
    if not (folder / "drawn" / "transforms.json").is_file():
        write_room(name, folder / "drawn")
    dataset = read_dataset(folder / "drawn", settings.capture)
    if not holds_capture(folder / "capture"):
        shutil.rmtree(folder / "upload", ignore_errors=True)  # what an interrupted run left
        training_capture(dataset, folder, settings.capture, silent)
    capture = subset(load_capture(folder / "capture"), dataset.train)
    scene = trained_scene(folder / "scene", capture, settings)
    if not (folder / "looked").is_dir():
        looked = label_capture(capture, settings.perception, settings.models, (), silent, masks=True)
        save_labelling(looked, folder / "looked")
    return dataset, capture, scene, load_labelling(folder / "looked")


def with_objects(scene: Scene, capture: Capture, labelling: Labelling, settings: Settings) -> Scene:
    """The scene with its objects, discovered and named as a job does it."""
    discovery, training = settings.discovery, settings.training
    model = load_name_model(labelling.detector, settings.models)
    objects, gaussians = find_scene_objects(
        scene.gaussians, capture, labelling, labelling.masks, discovery, training=training, name_model=model
    )
    head = SemanticHead.unlearnt(len(scene.dictionary), gaussians.codes.shape[1])
    return replace(scene, gaussians=gaussians, head=head, objects=objects)


def _row(name: str, folder: Path, settings: Settings, sheets: bool) -> dict[str, Any]:
    dataset, capture, scene, labelling = kept_room(name, folder, settings)
    found, seconds = timed(lambda: with_objects(scene, capture, labelling, settings))
    compared = measured(found, dataset, read_truth(folder / "drawn" / "truth.npz"))
    row = {"views": len(capture.views), **figures_of(compared), **_pictures(found, dataset, settings)}
    print(name, "; ".join(worst_of(compared)), flush=True)
    if sheets:
        draw_sheet(found, capture, RESULTS / f"rooms_{name}.jpg", scale=_SHEET_SCALE, quality=_SHEET_QUALITY)
    return {**row, "objects": len(found.objects.table) if found.objects else 0, "grouping_seconds": seconds["seconds"]}


def _pictures(scene: Scene, dataset: Dataset, settings: Settings) -> dict[str, float]:
    renderer, pairs = Renderer(scene, settings.query), []
    for view in dataset.test:
        assert view.posed is not None and view.rgb is not None
        image = torch.from_numpy(renderer.colors(view.posed).astype(np.float32) / 255)
        pairs.append((image, torch.from_numpy(view.rgb.astype(np.float32) / 255)))
    plain = [psnr(image, photo) for image, photo in pairs]
    corrected = [psnr(color_corrected(image, photo), photo) for image, photo in pairs]
    return {"psnr": round(float(np.mean(plain)), 2), "psnr_cc": round(float(np.mean(corrected)), 2)}


def _write(path: Path, name: str, row: Mapping[str, Any]) -> None:
    """Replace a room's row, and the mean over all rows."""
    rows = json.loads(path.read_text())["rows"] if path.is_file() else {}
    rows[name] = row
    write_json(path, {"rows": rows, "mean": mean_of(list(rows.values()))})
    print(name, json.dumps({key: value for key, value in row.items() if key != "provenance"}), flush=True)
    print("mean", json.dumps(mean_of(list(rows.values()))), flush=True)


def mean_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """The mean of each figure over the rooms that have it, and the shares of names over all rooms that have them."""
    names = dict.fromkeys(name for row in rows for name, value in row.items() if isinstance(value, int | float))
    means = {}
    for name in names:
        values = [row[name] for row in rows if isinstance(row.get(name), int | float) and row[name] == row[name]]
        means[name] = round(float(np.mean(values)), 4) if values else float("nan")
    for share, (part, whole) in _NAMED.items():
        counted = [row for row in rows if whole in row]
        total = sum(row[whole] for row in counted)
        means[share] = round(sum(row[part] for row in counted) / total, 4) if total else float("nan")
    return means


if __name__ == "__main__":
    _main()
