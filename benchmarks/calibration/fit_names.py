"""Fit `name_calibration.json`: how probable it is that the default detector calls an object right; and count
`found_names.json`: how often an object is called so that is one.

    python -m benchmarks.calibration.fit_names FOLDER [FOLDER ...] [--keep FOLDER] [--dry-run]

A folder has photos with poses and maps of true objects, laid out as `demo/sample`, or maps of labels, as `tabletop`;
`benchmarks.rooms` draws such rooms. The detector looks at 20 photos at most. As in a scene, a region votes for the true
object that it overlaps most, by at least a half, and an object's evidence for its best name is `name_evidence` of the
mean scores over the photos that show most of it. One object counts once. A name is right that is the true label, or
that `_SAME` says is another word for it. What was seen of a set that lies in `--keep` is not looked for again.

The model is logistic in ln(e / (1 - e)) of the evidence e, with an offset for each name, by ridge: names that are often
wrong, as "cup" for all that is round, need more evidence, and a name that was seen seldom is as good as the mean. What
one set has of one name is right or wrong together, as the books of a shelf: n such objects weigh √n. What
benchmarks/results/names.json counts are predictions by models that had seen no set of the kind ("desk-1" and "desk-11"
are of one kind).
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.optimize import minimize

from benchmarks.provenance import RESULTS, begin, parser_of, provenance, write_json
from fastsplat.service.capture.captures import Capture, CaptureReport, View
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.common.progress import silent
from fastsplat.service.instances.naming.naming import (
    FILE,
    NameCategory,
    NameModel,
    evidence_logit,
    name_evidence,
)
from fastsplat.service.instances.scene_objects import NAME_OVERLAP
from fastsplat.service.perception.class_names import COCO_80
from fastsplat.service.perception.label_maps.labelling import label_capture
from fastsplat.service.perception.results import Regions
from fastsplat.service.query.language.absence_policy import FOUND
from fastsplat.service.settings import Settings, load_settings
from fastsplat_contract.geometry.camera import Camera, PosedCamera

F64 = NDArray[np.float64]

_PHOTOS = 20
_LEAST_PX = 64
"""Pixels of an object from which a photo shows it."""
_MOST_SHOWN = 0.5
"""Of an object's usual pixels, from which a photo shows most of it."""
_RIDGE = 0.5
"""Of the names' offsets, whose mean is 0; of 0.5, 1, 2 and 4 the one by which kinds left out are most probable."""
_EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
"""Of predicted probabilities that are counted together."""
_SAME = frozenset(
    {("table", "dining table"), ("mug", "cup"), ("pen cup", "cup"), ("red scissors", "scissors"), ("notebook", "book")}
)
"""True labels and words of the detector that are right for them."""


@dataclass(frozen=True)
class Named:
    """One object that some photo shows.

    Attributes:
        group: its set.
        label: what it is.
        name: what it is called with the most evidence; "" for nothing.
        evidence: 0..1.
        right: whether that is what it is.
    """

    group: str
    label: str
    name: str
    evidence: float
    right: bool


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
    model = fitted(named, settings.perception.closed_set_detector)
    rows = left_out(named)
    print(json.dumps(rows, indent=1), json.dumps(found), sep="\n")
    if not options.dry_run:
        FILE.write_text(json.dumps(model.model_dump(mode="json"), indent=1) + "\n")
        FOUND.write_text(json.dumps({"detector": model.detector, "sets": model.sets, **found}, indent=1) + "\n")
        about = provenance(start, settings=options, chosen_on="the same objects, by kinds of sets that were left out")
        write_json(RESULTS / "names.json", {"rows": rows, "objects": len(named), **about})


def _stored_objects(folder: Path, settings: Settings, keep: Path | None) -> list[Named]:
    if keep is None:
        return named_objects(folder, settings)
    stored = keep / f"{folder.name}.json"
    if not stored.is_file():
        stored.write_text(json.dumps([vars(obj) for obj in named_objects(folder, settings)]))
    return [Named(**row) for row in json.loads(stored.read_text())]


def named_objects(folder: Path, settings: Settings) -> list[Named]:
    """What the detector calls the objects of one set."""
    document = json.loads((folder / "transforms.json").read_text())
    frames = document["frames"][:: -(-len(document["frames"]) // _PHOTOS)]
    camera = Camera(*(document[key] for key in ("w", "h", "fl_x", "fl_y", "cx", "cy")))
    labels = document.get("instances") or sorted(document["labels"], key=document["labels"].get)
    key = "instance_path" if document.get("instances") else "mask_path"
    maps = [np.asarray(Image.open(folder / frame[key])).astype(np.int64) for frame in frames]
    posed = [PosedCamera(camera, np.eye(4), frame["file_path"]) for frame in frames]  # poses count for nothing here
    views = tuple(View(posed_camera, folder / posed_camera.name) for posed_camera in posed)
    none = np.zeros((0, 3))
    capture = Capture(
        views, none.astype(np.float32), none.astype(np.uint8), "METRIC", CaptureReport("images", len(views))
    )
    labelling = label_capture(capture, settings.perception, settings.models, (), silent)
    names = [entry.label for entry in labelling.dictionary.entries]
    scores = mean_scores(maps, labelling.regions, len(labels), len(names))
    evidence = name_evidence(scores)
    visible = np.max([np.bincount(ids.ravel(), minlength=len(labels) + 1) for ids in maps], axis=0)[1:] >= _LEAST_PX
    called = [names[best - 1] if best else "" for best in (evidence.argmax(axis=1) * evidence.any(axis=1)).tolist()]
    return [
        Named(folder.name, label, name, float(evidence[row].max()), is_right(label, name))
        for row, (label, name) in enumerate(zip(labels, called, strict=True))
        if visible[row]
    ]


def mean_scores(maps: Sequence[NDArray[np.int64]], regions: Sequence[Regions], objects: int, names: int) -> F64:
    """float64 [T, N + 1]: as `NameVotes.mean_scores`, of true objects by their pixels.

    Args:
        maps: int64 [H, W] of each photo, the true object of each pixel from 1, 0 for none.
        regions: of each photo.
        objects: T.
        names: N.
    """
    area = np.array([np.bincount(ids.ravel(), minlength=objects + 1)[1 : objects + 1] for ids in maps])
    usual = [np.median(areas[areas >= _LEAST_PX]) if (areas >= _LEAST_PX).any() else np.inf for areas in area.T]
    able = ((area >= _LEAST_PX) & (area >= _MOST_SHOWN * np.array(usual))).sum(axis=0)
    scores = np.zeros((objects, names + 1))
    for ids, photo_regions, photo_areas in zip(maps, regions, area, strict=True):
        best = np.zeros_like(scores)
        pairs = np.bincount(
            (photo_regions.ids.astype(np.int64) * (objects + 1) + ids).ravel(),
            minlength=(len(photo_regions.votes) + 1) * (objects + 1),
        ).reshape(-1, objects + 1)
        for number, votes in enumerate(photo_regions.votes, start=1):
            common = pairs[number, 1:]
            overlap = common / np.maximum(pairs[number].sum() + photo_areas - common, 1)
            obj = int(overlap.argmax())
            if overlap[obj] >= NAME_OVERLAP:
                for label, score in votes:
                    best[obj, label] = max(best[obj, label], score)
        scores += best
    return np.minimum(scores / np.maximum(able, 1)[:, None], 1.0)


def is_right(label: str, name: str) -> bool:
    """Whether an object that is `label` is rightly called `name`."""
    return label_key(label) == label_key(name) or (label, name) in _SAME


def found_names(objects: Sequence[Named]) -> dict[str, Any]:
    """How many objects of each of the detector's names were called so, of how many; and the share of all but books,
    which lie in rows of their like."""
    words = [label_key(dict(_SAME).get(obj.label, obj.label)) for obj in objects]
    found = Counter(word for word, obj in zip(words, objects, strict=True) if obj.right)
    there = Counter(word for word in words if word in map(label_key, COCO_80))
    share = (found.total() - found["book"]) / (there.total() - there["book"])
    return {"share": round(share, 3), "names": {word: (found[word], there[word]) for word in sorted(there)}}


def fitted(named: Sequence[Named], detector: str) -> NameModel:
    """The model of these objects."""
    names = sorted({label_key(obj.name) for obj in named})
    factor, offset, *offsets = _fit(named, names)
    counted = {name: [obj.right for obj in named if label_key(obj.name) == name] for name in names}
    return NameModel(
        detector=detector,
        sets=tuple(dict.fromkeys(obj.group for obj in named)),
        factor=round(factor, 3),
        offset=round(offset, 3),
        categories={
            name: NameCategory(offset=round(name_offset, 3), objects=len(counted[name]), right=sum(counted[name]))
            for name, name_offset in zip(names, offsets, strict=True)
        },
    )


def left_out(named: Sequence[Named]) -> list[dict[str, float]]:
    """How many objects had a probability between two edges, and how many of them were right, by models that saw no set
    of their kind."""
    predicted = np.zeros(len(named))
    kinds = np.array([obj.group.split("-")[0] for obj in named])
    for kind in set(kinds.tolist()):
        model = fitted([obj for obj, obj_kind in zip(named, kinds, strict=True) if obj_kind != kind], "")
        for row in np.flatnonzero(kinds == kind):
            predicted[row] = model.probability(np.array([[named[row].evidence]]), [named[row].name])[0, 0]
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


def _fit(named: Sequence[Named], names: Sequence[str]) -> list[float]:
    """Factor and offset, then the offset of each name, by maximum likelihood with a ridge; objects of one set and name
    weigh less the more they are."""
    logit = evidence_logit(np.array([obj.evidence for obj in named]))
    alike = Counter((obj.group, label_key(obj.name)) for obj in named)
    weight = np.array([alike[obj.group, label_key(obj.name)] ** -0.5 for obj in named])
    place = np.array([names.index(label_key(obj.name)) for obj in named])
    sign = np.where([obj.right for obj in named], 1.0, -1.0)

    def loss(factors: F64) -> float:
        predicted = factors[0] * logit + factors[1] + factors[2:][place]
        return float((weight * np.logaddexp(0.0, -sign * predicted)).sum() + _RIDGE / 2 * (factors[2:] ** 2).sum())

    optimum = minimize(loss, np.zeros(2 + len(names)), method="L-BFGS-B")
    return [float(factor) for factor in optimum.x]


if __name__ == "__main__":
    main()
