"""What changed in drawn rooms, told by ten photos of another day.

    python -m benchmarks.changes [ROOM ...] [--split test] [--sets 4] [--unchanged 4] [--first 0] [--keep FOLDER]
        [--rows]

Rooms are drawn and trained as by `benchmarks.rooms`, whose folders `--keep` shares. Of each so many sets of ten photos
are drawn with one to six changes, and so many with none, from other places and in light of up to ±.7 EV; the photos
are placed by the product, without a word of where they were taken, and compared with the scene. An event counts as
found where an answer has its kind and the middles of its boxes lie in the true boxes, 2 cm around included; each
answers for one (a point an event, as in SceneDiff's protocol).

  found of changes, wrong: events, over all sets; f1: of these;
  unchanged_wrong: events told of sets without a change, of unchanged sets;
  move_error_cm_median: between the middles of told and true motions of what moved;
  cpu_seconds: of placing and comparing ten photos, without the scene's landmarks.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.changes.changed_rooms import TrueChange, later_photos
from benchmarks.provenance import begin, parser_of, provenance, put_row
from benchmarks.rooms.__main__ import kept_room, with_objects
from benchmarks.rooms.drawing import ROOMS
from benchmarks.splits import results_file
from fastsplat.service.application.answering.scene_changes import scene_changes
from fastsplat.service.localization.landmarks import Landmarks, find_landmarks
from fastsplat.service.localization.photo_placement import Photo, place_photos
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.planning.presets import override_training
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.settings import Settings, load_settings
from fastsplat_contract.photos.localization import SceneChange

_MOST_CHANGES = 6
_SLACK = 0.02
_CHOSEN_ON = {
    "validation": "bounds of changes were chosen on sets of these rooms",
    "test": "nothing was chosen on these rooms; bounds of changes: on validation rooms",
}


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("rooms", nargs="*", metavar="ROOM")
    parser.add_argument("--split", choices=tuple(ROOMS), default="validation")
    parser.add_argument("--sets", type=int, default=4)
    parser.add_argument("--first", type=int, default=0, help="number of the first set: each number is another set")
    parser.add_argument("--unchanged", type=int, default=4)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--rows", action="store_true", help="print what is missed and wrong")
    options = parser.parse_args()
    bounds = {"iterations": 2500, "max_gaussians": 30_000}
    settings = override_training(load_settings(), **bounds, time_budget_s=None, held_out_every=0)
    for name in options.rooms or ROOMS[options.split]:
        start = begin()
        with tempfile.TemporaryDirectory(prefix="fastsplat-") as work:
            row = _row(name, (options.keep or Path(work)) / name, settings, options)
        about = provenance(start, settings=options, chosen_on=_CHOSEN_ON[options.split])
        put_row(results_file("changes", options.split), name, {**row, **about})
        print(name, json.dumps(row), flush=True)


def _row(name: str, folder: Path, settings: Settings, options: argparse.Namespace) -> dict[str, Any]:
    index, landmarks = _opened(name, folder, settings)
    totals = dict.fromkeys(("found", "changes", "wrong", "unchanged_wrong"), 0)
    errors: list[float] = []
    seconds: list[float] = []
    for number in range(options.sets + options.unchanged):
        count = 1 + number % _MOST_CHANGES if number < options.sets else 0
        later = later_photos(name, 100 + options.first + number, count)
        began = time.process_time()
        placed = place_photos([Photo(photo) for photo in later.photos], landmarks, index.geometry)
        sizes = [(photo.shape[1], photo.shape[0]) for photo in later.photos]
        changes, _, _ = scene_changes(index, placed, sizes)
        seconds.append(time.process_time() - began)
        pairs = _pairs(changes, later.changes)
        totals["found"] += len(pairs)
        totals["changes"] += len(later.changes)
        totals["wrong" if count else "unchanged_wrong"] += len(changes) - len(pairs)
        errors += [
            _move_error(changes[row], later.changes[true]) for row, true in pairs if changes[row].kind == "moved"
        ]
        if options.rows:
            _print(changes, later.changes, pairs, f"{name} {number}")
    return {
        **totals,
        "unchanged": options.unchanged,
        **_derived(totals, errors),
        "cpu_seconds": round(float(np.median(seconds)), 1),
    }


def _derived(totals: dict[str, int], errors: list[float]) -> dict[str, float | None]:
    all_told = totals["changes"] + totals["found"] + totals["wrong"]
    return {
        "f1": round(2 * totals["found"] / all_told, 3) if all_told else None,
        "move_error_cm_median": round(100 * float(np.median(errors)), 1) if errors else None,
    }


def _opened(name: str, folder: Path, settings: Settings) -> tuple[SceneIndex, Landmarks]:
    dataset, capture, scene, labelling = kept_room(name, folder, settings)
    del dataset
    scene = with_objects(scene, capture, labelling, settings)
    encoder = open_text_encoder(settings.perception.text_encoder, settings.models)
    index = SceneIndex(scene, encoder, settings.query)
    photos = [(view.posed, _reader(folder / "drawn" / view.posed.name)) for view in capture.views]
    return index, find_landmarks(photos, index.geometry)


def _reader(path: Path) -> Any:
    return lambda: np.asarray(Image.open(path).convert("RGB"))


def _pairs(changes: Sequence[SceneChange], truth: Sequence[TrueChange]) -> list[tuple[int, int]]:
    """Rows of events and of the true changes that they tell."""
    pairs: list[tuple[int, int]] = []
    for row, change in enumerate(changes):
        free = [number for number in range(len(truth)) if number not in {true for _, true in pairs}]
        right = [number for number in free if _tells(change, truth[number])]
        if right:
            pairs.append((row, right[0]))
    return pairs


def _tells(change: SceneChange, true: TrueChange) -> bool:
    if change.kind != true.kind:
        return False
    places = [(change.before, true.before), (change.after, true.after)]
    return all(box is None or (place is not None and _within(place.center.position, box)) for place, box in places)


def _within(point: Sequence[float], box: np.ndarray) -> bool:
    return bool((np.array(point) >= box[0] - _SLACK).all() and (np.array(point) <= box[1] + _SLACK).all())


def _move_error(change: SceneChange, true: TrueChange) -> float:
    assert change.before and change.after and true.before is not None and true.after is not None
    shift = np.subtract(change.after.center.position, change.before.center.position)
    return float(np.linalg.norm(shift - (true.after - true.before).mean(axis=0)))


def _print(
    changes: Sequence[SceneChange], truth: Sequence[TrueChange], pairs: list[tuple[int, int]], about: str
) -> None:
    right, found = {row for row, _ in pairs}, {true for _, true in pairs}
    wrong = [
        f"{change.kind} {change.object_id} {change.probability:.2f}"
        for row, change in enumerate(changes)
        if row not in right
    ]
    missed = [f"{change.kind} {change.label}" for number, change in enumerate(truth) if number not in found]
    print(about, "wrong:", wrong, "missed:", missed, flush=True)


if __name__ == "__main__":
    _main()
