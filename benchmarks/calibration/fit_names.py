"""Fit `service/instances/name_calibration.json`: how probable it is that the default detector calls a thing right.

    python -m benchmarks.calibration.fit_names FOLDER [FOLDER ...] [--dry-run]

A folder has photos with poses and maps of true things, laid out as `demo/sample`, or maps of labels, as `tabletop`.
The detector looks at every second photo. As in a scene, a region votes for the true thing that it overlaps most, by at
least a half, and a thing's evidence for its best name is `name_evidence` of the mean scores over the photos that show
most of it. One thing counts once. A name is right that is the true label, or that `_SAME` says is another word for it.

The curve is a logistic model of the evidence's logarithm, with one wrong and one right thing added so that it stays off
0 and 1, and nowhere more than the rule of succession allows for the things that had as much evidence or more:
(right + 1) / (things + 2). Printed beside it is the calibration error of predictions for sets that were left out.
"""

from __future__ import annotations

import datetime
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.calibration.separation import auroc, calibration_error, logistic_fit
from benchmarks.provenance import parser_of
from fastsplat.service.capture.types import Capture, CaptureReport, View
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.common.logistic import logistic
from fastsplat.service.common.progress import silent
from fastsplat.service.instances.name_calibration import FILE, NameCurve, name_evidence
from fastsplat.service.instances.scene_things import NAME_OVERLAP
from fastsplat.service.perception.labelling import label_capture
from fastsplat.service.perception.types import Regions
from fastsplat.service.settings import Settings, load_settings
from fastsplat_contract.camera import Camera, PosedCamera

F64 = NDArray[np.float64]

_EVERY = 2
_LEAST_PX = 64
"""Pixels of a thing from which a photo shows it."""
_MOST_SHOWN = 0.5
"""Of a thing's usual pixels, from which a photo shows most of it."""
_EDGES = (0.0, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
_SAME: frozenset[tuple[str, str]] = frozenset()
"""True labels and words of the detector that are right for them."""


@dataclass(frozen=True)
class Named:
    """One thing that the detector has a name for.

    Attributes:
        group: its set.
        label: what it is.
        name: what it is called with the most evidence.
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
    parser.add_argument("--dry-run", action="store_true", help="Write nothing.")
    options = parser.parse_args()
    settings = load_settings()
    named = [thing for folder in options.folders for thing in named_things(folder, settings)]
    for thing in sorted(named, key=lambda one: -one.evidence):
        print(
            f"{thing.evidence:.2f} {'right' if thing.right else 'WRONG'} {thing.group}: {thing.label} is {thing.name}"
        )
    curve = fitted(named, settings.perception.closed_set_detector)
    report(named, curve)
    if not options.dry_run:
        FILE.write_text(json.dumps(curve.model_dump(mode="json"), indent=1) + "\n")


def named_things(folder: Path, settings: Settings) -> list[Named]:
    """What the detector calls the things of one set."""
    document = json.loads((folder / "transforms.json").read_text())
    frames = document["frames"][::_EVERY]
    camera = Camera(*(document[key] for key in ("w", "h", "fl_x", "fl_y", "cx", "cy")))
    labels = document.get("instances") or sorted(document["labels"], key=document["labels"].get)
    key = "instance_path" if document.get("instances") else "mask_path"
    maps = [np.asarray(Image.open(folder / frame[key])).astype(np.int64) for frame in frames]
    posed = [PosedCamera(camera, np.eye(4), frame["file_path"]) for frame in frames]  # poses count for nothing here
    views = tuple(View(each, folder / each.name) for each in posed)
    none = np.zeros((0, 3))
    capture = Capture(
        views, none.astype(np.float32), none.astype(np.uint8), "METRIC", CaptureReport("images", len(views))
    )
    labelling = label_capture(capture, settings.perception, settings.models, (), silent)
    names = [entry.label for entry in labelling.dictionary.entries]
    scores = mean_scores(maps, labelling.regions, len(labels), len(names))
    evidence = name_evidence(scores)
    best = evidence.argmax(axis=1)
    return [
        Named(
            folder.name,
            labels[row],
            names[name - 1],
            float(evidence[row, name]),
            is_right(labels[row], names[name - 1]),
        )
        for row, name in enumerate(best.tolist())
        if evidence[row, name] > 0
    ]


def mean_scores(maps: Sequence[NDArray[np.int64]], regions: Sequence[Regions], things: int, names: int) -> F64:
    """float64 [T, N + 1]: as `NameVotes.mean_scores`, of true things by their pixels.

    Args:
        maps: int64 [H, W] of each photo, the true thing of each pixel from 1, 0 for none.
        regions: of each photo.
        things: T.
        names: N.
    """
    area = np.array([np.bincount(each.ravel(), minlength=things + 1)[1 : things + 1] for each in maps])
    usual = [np.median(own[own >= _LEAST_PX]) if (own >= _LEAST_PX).any() else np.inf for own in area.T]
    able = ((area >= _LEAST_PX) & (area >= _MOST_SHOWN * np.array(usual))).sum(axis=0)
    scores = np.zeros((things, names + 1))
    for ids, own, shown in zip(maps, regions, area, strict=True):
        best = np.zeros_like(scores)
        pairs = np.bincount(
            (own.ids.astype(np.int64) * (things + 1) + ids).ravel(), minlength=(len(own.votes) + 1) * (things + 1)
        ).reshape(-1, things + 1)
        for number, votes in enumerate(own.votes, start=1):
            common = pairs[number, 1:]
            overlap = common / np.maximum(pairs[number].sum() + shown - common, 1)
            thing = int(overlap.argmax())
            if overlap[thing] >= NAME_OVERLAP:
                for label, score in votes:
                    best[thing, label] = max(best[thing, label], score)
        scores += best
    return np.minimum(scores / np.maximum(able, 1)[:, None], 1.0)


def is_right(label: str, name: str) -> bool:
    """Whether a thing that is `label` is rightly called `name`."""
    return label_key(label) == label_key(name) or (label, name) in _SAME


def fitted(named: Sequence[Named], detector: str) -> NameCurve:
    """The curve of these things."""
    evidence = np.array([thing.evidence for thing in named])
    right = np.array([thing.right for thing in named])
    place = np.searchsorted(_EDGES, evidence, side="right") - 1
    things = np.bincount(place, minlength=len(_EDGES))
    correct = np.bincount(place, right, minlength=len(_EDGES))
    above, right_above = things[::-1].cumsum()[::-1], correct[::-1].cumsum()[::-1]
    most = (right_above + 1) / (above + 2)
    probability = np.minimum(_predicted(evidence, right, np.array(_EDGES)), most)
    return NameCurve(
        date=datetime.date.today().isoformat(),
        detector=detector,
        sets=tuple(dict.fromkeys(thing.group for thing in named)),
        evidence=_EDGES,
        probability=tuple(round(float(each), 3) for each in np.minimum.accumulate(probability[::-1])[::-1]),
        things=tuple(things.tolist()),
        right=tuple(int(each) for each in correct),
    )


def report(named: Sequence[Named], curve: NameCurve) -> None:
    """The curve with its counts, and how well it holds for sets that were left out."""
    rows = zip(curve.evidence, curve.probability, curve.things, curve.right, strict=True)
    for evidence, probability, things, right in rows:
        print(f"from {evidence:.2f}: {probability:.3f}, {right} of {things} right")
    evidence, right = np.array([t.evidence for t in named]), np.array([t.right for t in named])
    groups = np.array([thing.group for thing in named])
    predicted = np.zeros(len(named))
    for group in set(groups.tolist()):
        out = groups == group
        predicted[out] = _predicted(evidence[~out], right[~out], evidence[out])
    error = calibration_error(predicted, right.astype(np.float64), bins=5)
    print(f"of sets left out: calibration error {error:.3f}, area {auroc(predicted[right], predicted[~right]):.3f}")
    for bound in (0.75, 0.95):
        chosen = predicted >= bound
        print(f"of sets left out: {right[chosen].sum()} of {chosen.sum()} right from {bound}")


def _predicted(evidence: F64, right: NDArray[np.bool_], at: F64) -> F64:
    known = np.append(evidence, [np.median(evidence)] * 2)
    factor, offset = logistic_fit(np.log(known)[:, None], np.append(right, [True, False]))
    return np.asarray(logistic(factor * np.log(np.maximum(at, 1e-3)) + offset))


if __name__ == "__main__":
    main()
