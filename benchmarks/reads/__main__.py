"""What is written on objects: lines read in photos of drawn rooms, and on the right object.

    python -m benchmarks.reads [--split test] [--rooms 3] [--width 1600]

Each room has about ten boxes and books on a table, labelled with one to three lines of one to three words in five
typefaces; 27 photos with a phone's faults, no shadows. Objects are the true ones, as points on their surfaces: what is
measured is reading, not discovery. A line is to be read if one photo shows it whole, not much from the side, its
capitals at least 20 pixels high.

  lines: to be read; recall: of them, those that their object says letter for letter, capitals and spaces aside;
  precision: of all lines that objects say, those that are printed on them, of whatever height;
  recall_at_95, threshold: with the least probability from which precision is 0.95 over all rooms;
  cpu_seconds, seconds: of reading a room's photos.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.objects.discovered import timed
from benchmarks.provenance import begin, parser_of, provenance, write_json
from benchmarks.reads.drawing import FlatStudio
from benchmarks.reads.labels import DOTS, Line, labelled_room, true_objects
from benchmarks.rooms.drawing import camera_of
from benchmarks.rooms.pictures import phone_faults, photo_of
from benchmarks.splits import results_file
from fastsplat.service.capture.captures import View
from fastsplat.service.instances.naming.object_reads import with_reads
from fastsplat.service.perception.readers.ppocr import open_reader
from fastsplat.service.scene.artefact.scene import Objects
from fastsplat.service.settings import Settings, load_settings
from fastsplat_contract.geometry.camera import PosedCamera

_CHOSEN_ON = "how many views must read a line: on the rooms of the validation split"
_SEEDS = {"validation": 100, "test": 200}
_LEAST_PX, _PRECISION, _SPACING = 20.0, 0.95, 0.006
_Said = tuple[float, bool]
"""Probability of a line that an object says, and whether it is printed there."""


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--split", choices=tuple(_SEEDS), default="validation", help="which rooms")
    parser.add_argument("--rooms", type=int, default=3)
    parser.add_argument("--width", type=int, default=1600, help="of photos, pixels")
    options = parser.parse_args()
    start, settings = begin(), load_settings()
    rows: list[dict[str, Any]] = []
    said: list[_Said] = []
    found: list[float] = []
    for seed in range(_SEEDS[options.split], _SEEDS[options.split] + options.rooms):
        row, room_reads, probable = _measured(seed, options.width, settings)
        print(seed, row, flush=True)
        rows, said, found = [*rows, row], [*said, *room_reads], [*found, *probable]
    document = {"rooms": rows, **figures(said, found)}
    print({name: value for name, value in document.items() if name != "rooms"})
    about = provenance(start, settings=options, chosen_on=_CHOSEN_ON)
    write_json(results_file("reads", options.split), {**about, **document})


def figures(said: Sequence[_Said], found: Sequence[float]) -> dict[str, float]:
    """Recall and precision of all that is said, and recall where precision is kept.

    Args:
        said: see `_Said`.
        found: of each line to be read, the probability with which it is said; 0 where it is not.
    """
    likely = sorted({probability for probability, _ in said}, reverse=True)
    thresholds = [
        threshold for threshold in likely if _precision([read for read in said if read[0] >= threshold]) >= _PRECISION
    ]
    least = min(thresholds, default=1.0)
    return {
        "lines": len(found),
        "recall": round(float(np.mean([probability > 0 for probability in found])), 4),
        "precision": round(_precision(said), 4),
        "recall_at_95": round(float(np.mean([probability >= least and probability > 0 for probability in found])), 4),
        "threshold": round(least, 4),
    }


def _precision(said: Sequence[_Said]) -> float:
    return float(np.mean([right for _, right in said])) if said else 1.0


def _measured(seed: int, width: int, settings: Settings) -> tuple[dict[str, Any], list[_Said], list[float]]:
    room, lines = labelled_room(seed)
    studio, camera, rng = FlatStudio(room, DOTS), camera_of(width), np.random.default_rng([seed, 1])
    gaussians, objects = true_objects(room, _SPACING)
    views, highest = [], np.zeros(len(lines))
    with tempfile.TemporaryDirectory(prefix="fastsplat-") as folder:
        for number, pose in enumerate(room.poses):
            path = Path(folder) / f"{number:03d}.jpg"
            view = studio.draw(PosedCamera(camera, pose, path.name))
            Image.fromarray(photo_of(view.light, phone_faults(rng), rng)).save(path, quality=92)
            views.append(View(view.posed, path))
            highest = np.maximum(highest, [line.height_in(view) for line in lines])
        reader, side = open_reader(settings.perception, settings.models), settings.discovery.max_side
        read, seconds = timed(lambda: with_reads(objects, gaussians, views, reader, side))
    said, found = judged(read, lines, (highest >= _LEAST_PX).tolist())
    return {"photos": len(views), **figures(said, found), **seconds}, said, found


def judged(objects: Objects, lines: Sequence[Line], legible: Sequence[bool]) -> tuple[list[_Said], list[float]]:
    """What objects say, and how probably they say the legible lines that are printed on them.

    Args:
        objects: with their reads.
        lines: that are printed.
        legible: bool [len(lines)], those that are to be read.
    """
    printed = {(line.object_id, _letters(line.text)) for line in lines}
    said: dict[tuple[int, str], float] = {}
    for obj in objects.table:
        for read in obj.reads:
            key = (obj.id, _letters(read.text))
            said[key] = max(read.probability, said.get(key, 0.0))
    keys = [(line.object_id, _letters(line.text)) for line, readable in zip(lines, legible, strict=True) if readable]
    return [(probability, key in printed) for key, probability in said.items()], [said.get(key, 0.0) for key in keys]


def _letters(text: str) -> str:
    return "".join(letter for letter in text.casefold() if letter.isalnum())


if __name__ == "__main__":
    _main()
