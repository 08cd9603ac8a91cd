"""Fit `name_calibration.json`: how probable it is that the default detector calls an object right; and count
`found_names.json`: how often an object is called so that is one.

    python -m benchmarks.calibration.fit_names FOLDER [FOLDER ...] [--keep FOLDER] [--dry-run]

A folder has photos with poses and maps of true objects, laid out as `demo/sample`, or maps of labels, as `tabletop`;
`benchmarks.rooms` draws such rooms. The detector looks at 20 photos at most; evidence and model are those of
`detector_calibration`, which calibrates other detectors where they run. One object counts once. A name is right that is
the true label, or that `_SAME` says is another word for it. What was seen of a set that lies in `--keep` is not looked
for again. What benchmarks/results/names.json counts are predictions by models that had seen no set of the kind
("desk-1" and "desk-11" are of one kind).
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.provenance import RESULTS, begin, parser_of, provenance, write_json
from fastsplat.service.capture.captures import View
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.instances.naming.name_models import FILE
from fastsplat.service.jobs.detector_calibration import (
    NamedObject,
    fit_name_model,
    named_objects,
    probabilities_left_out,
)
from fastsplat.service.perception.class_names import COCO_80
from fastsplat.service.query.language.absence_policy import FOUND
from fastsplat.service.settings import Settings, load_settings
from fastsplat_contract.geometry.camera import Camera, PosedCamera

_PHOTOS = 20
_EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
"""Of predicted probabilities that are counted together."""
_SAME = frozenset(
    {("table", "dining table"), ("mug", "cup"), ("pen cup", "cup"), ("red scissors", "scissors"), ("notebook", "book")}
)
"""True labels and words of the detector that are right for them."""


def main() -> None:
    """Command line."""
    parser = parser_of(__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--keep", type=Path, help="For what was seen of each set.")
    parser.add_argument("--dry-run", action="store_true", help="Write nothing but that.")
    options = parser.parse_args()
    start, settings = begin(), load_settings()
    objects = [obj for folder in options.folders for obj in _stored_objects(folder, settings, options.keep)]
    named, found = [obj for obj in objects if obj.name], found_names(objects)
    for obj in sorted(named, key=lambda obj: -obj.evidence):
        print(f"{obj.evidence:.2f} {'right' if obj.right else 'WRONG'} {obj.group}: {obj.label} is {obj.name}")
    model = fit_name_model(named, settings.perception.closed_set_detector)
    rows = left_out(named)
    print(json.dumps(rows, indent=1), json.dumps(found), sep="\n")
    if not options.dry_run:
        FILE.write_text(json.dumps(model.model_dump(mode="json"), indent=1) + "\n")
        FOUND.write_text(json.dumps({"detector": model.detector, "sets": model.sets, **found}, indent=1) + "\n")
        about = provenance(start, settings=options, chosen_on="the same objects, by kinds of sets that were left out")
        write_json(RESULTS / "names.json", {"rows": rows, "objects": len(named), **about})


def _stored_objects(folder: Path, settings: Settings, keep: Path | None) -> list[NamedObject]:
    if keep is None:
        return _named_objects(folder, settings)
    stored = keep / f"{folder.name}.json"
    if not stored.is_file():
        stored.write_text(json.dumps([obj._asdict() for obj in _named_objects(folder, settings)]))
    return [NamedObject(**row) for row in json.loads(stored.read_text())]


def _named_objects(folder: Path, settings: Settings) -> list[NamedObject]:
    """What the detector calls the objects of one set."""
    document = json.loads((folder / "transforms.json").read_text())
    frames = document["frames"][:: -(-len(document["frames"]) // _PHOTOS)]
    camera = Camera(*(document[key] for key in ("w", "h", "fl_x", "fl_y", "cx", "cy")))
    labels = document.get("instances") or sorted(document["labels"], key=document["labels"].get)
    key = "instance_path" if document.get("instances") else "mask_path"
    maps = [np.asarray(Image.open(folder / frame[key])).astype(np.int64) for frame in frames]
    posed = [PosedCamera(camera, np.eye(4), frame["file_path"]) for frame in frames]  # poses count for nothing here
    views = [View(posed_camera, folder / posed_camera.name) for posed_camera in posed]
    objects = named_objects(views, maps, labels, folder.name, settings.perception, settings.models)
    return [obj._replace(right=is_right(obj.label, obj.name)) for obj in objects]


def is_right(label: str, name: str) -> bool:
    """Whether an object that is `label` is rightly called `name`."""
    return label_key(label) == label_key(name) or (label, name) in _SAME


def found_names(objects: Sequence[NamedObject]) -> dict[str, Any]:
    """How many objects of each of the detector's names were called so, of how many; and the share of all but books,
    which lie in rows of their like."""
    words = [label_key(dict(_SAME).get(obj.label, obj.label)) for obj in objects]
    found = Counter(word for word, obj in zip(words, objects, strict=True) if obj.right)
    there = Counter(word for word in words if word in map(label_key, COCO_80))
    share = (found.total() - found["book"]) / (there.total() - there["book"])
    return {"share": round(share, 3), "names": {word: (found[word], there[word]) for word in sorted(there)}}


def left_out(named: Sequence[NamedObject]) -> list[dict[str, float]]:
    """How many objects had a probability between two edges, and how many of them were right, by models that saw no set
    of their kind."""
    predicted = probabilities_left_out(named)
    right = np.array([obj.right for obj in named])
    place = np.clip(np.searchsorted(_EDGES, predicted, side="right") - 1, 0, len(_EDGES) - 2)
    return [
        {
            "from": low,
            "to": high,
            "objects": int((place == number).sum()),
            "right": int(right[place == number].sum()),
            "predicted": round(float(predicted[place == number].mean()), 3),
        }
        for number, (low, high) in enumerate(pairwise(_EDGES))
        if (place == number).any()
    ]


if __name__ == "__main__":
    main()
