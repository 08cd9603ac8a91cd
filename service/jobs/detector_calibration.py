"""Calibration of an open-vocabulary detector on the machine that uses it: how probable its names are.

Drawn rooms are labelled as a scene's photos are. Figures are of rooms whose kind set nothing."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.optimize import minimize

from fastsplat.service.capture.captures import Capture, CaptureReport, View
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.common.progress import Progress, ProgressEvent, silent
from fastsplat.service.instances.naming.name_models import F64, HeldOutNames, NameCategory, NameModel, evidence_logit
from fastsplat.service.instances.naming.naming import MOST_SEEN, NAMED_FROM, name_evidence
from fastsplat.service.instances.scene_objects import NAME_OVERLAP
from fastsplat.service.jobs.looks_rooms import LabeledRoom, drawn_rooms
from fastsplat.service.perception.detectors.open_detectors import known_texts
from fastsplat.service.perception.label_maps.labelling import label_capture
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Regions
from fastsplat.service.query.phrases.object_looks import is_true_of
from fastsplat_contract.errors import ModelUnavailableError
from fastsplat_contract.geometry.camera import Camera, PosedCamera

_LEAST_PX = 64  # pixels of an object from which a photo shows it
_LONGEST_S = 1200  # for all rooms; OWLv2 takes half of it on two cores
_RIDGE = 0.5  # of the names' offsets, whose mean is 0; the most probable one for kinds left out of 0.5, 1, 2 and 4


class NamedObject(NamedTuple):
    """What a detector calls one object that photos show."""

    group: str  # its set; the part before "-" is the kind
    label: str  # what it is
    name: str  # of the most evidence; "" for none
    evidence: float  # 0..1
    right: bool


def calibrate_detector(
    settings: PerceptionSettings,
    models: Path,
    report_progress: Progress = silent,
    rooms: Iterable[LabeledRoom] | None = None,
) -> NameModel:
    """Measures how probable the names of `settings.open_set_detector` are; it is asked for the labels of all rooms.

    Args:
        report_progress: stage "calibration"; may raise `CancelledError`.
        rooms: of at least two kinds; None: those of the package.

    After `_LONGEST_S` the rest of the rooms are left out.

    Raises:
        ModelUnavailableError: the detector, its text encoder or the segmenter is missing or damaged, or at its pace
            fewer rooms than there are kinds would be looked at.
    """
    drawn = list(drawn_rooms() if rooms is None else rooms)
    words = sorted({label for room in drawn for label in room.labels.values()})
    settings = settings.model_copy(update={"tags": known_texts(words, settings, models), "tagger": ""})
    named: list[NamedObject] = []
    begin, kinds = time.monotonic(), len({room.kind for room in drawn})

    def on_view(number: int, event: ProgressEvent) -> None:
        fraction = (number + event.fraction) / len(drawn)
        report_progress(ProgressEvent("calibration", fraction, f"drawn room {number + 1}: {event.message}"))
        seconds = time.monotonic() - begin
        if number < kinds and seconds > _LONGEST_S * (number + 1) / kinds:
            raise ModelUnavailableError(
                f"{settings.open_set_detector} is too slow to calibrate: {seconds:.0f} s in drawn room {number + 1}",
                field=settings.open_set_detector,
                limit=f"{kinds} rooms in {_LONGEST_S} s",
                hint="Its names are suggestions.",
            )

    for number, room in enumerate(drawn):
        if time.monotonic() - begin > _LONGEST_S:
            break
        named += _named_in_room(room, f"{room.kind}-{number}", settings, models, partial(on_view, number))
    called = [obj for obj in named if obj.name]
    held_out = _held_out(named, probabilities_left_out(called))
    return fit_name_model(called, settings.open_set_detector).model_copy(update={"held_out": held_out})


def _named_in_room(
    room: LabeledRoom, group: str, settings: PerceptionSettings, models: Path, progress: Progress
) -> list[NamedObject]:
    with TemporaryDirectory(prefix="fastsplat-") as folder:
        views = []
        for number, (picture, _) in enumerate(room.views):
            path = Path(folder) / f"{number}.png"
            Image.fromarray(picture).save(path, compress_level=1)
            height, width = picture.shape[:2]
            camera = Camera(width, height, width, width, width / 2, height / 2)
            views.append(View(PosedCamera(camera, np.eye(4), path.name), path))  # poses count for nothing here
        maps = [ids.astype(np.int64) for _, ids in room.views]
        return named_objects(views, maps, list(room.labels.values()), group, settings, models, progress)


def named_objects(
    views: Sequence[View],
    maps: Sequence[NDArray[np.int64]],
    labels: Sequence[str],
    group: str,
    settings: PerceptionSettings,
    models: Path,
    progress: Progress = silent,
) -> list[NamedObject]:
    """What the configured detector calls the objects that photos show.

    As in a scene, a region votes for the object that it overlaps most, by at least a half, and an object's evidence for
    its best name is `name_evidence` of the mean scores over the photos that show most of it.

    Args:
        maps: int64 [H, W] of each photo, the object of each pixel from 1, 0 for none.
        labels: of the objects, from 1.
        progress: as of `label_capture`.
    """
    none = np.zeros((0, 3))
    report = CaptureReport("images", len(views))
    capture = Capture(tuple(views), none.astype(np.float32), none.astype(np.uint8), "METRIC", report)
    labelling = label_capture(capture, settings, models, (), progress)
    names = [entry.label for entry in labelling.dictionary.entries]
    evidence = name_evidence(mean_scores(maps, labelling.regions, len(labels), len(names)))
    visible = np.max([np.bincount(ids.ravel(), minlength=len(labels) + 1) for ids in maps], axis=0)[1:] >= _LEAST_PX
    called = [names[best - 1] if best else "" for best in (evidence.argmax(axis=1) * evidence.any(axis=1)).tolist()]
    return [
        NamedObject(group, label, name, float(evidence[row].max()), bool(name) and is_true_of(name, label))
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
    able = ((area >= _LEAST_PX) & (area >= MOST_SEEN * np.array(usual))).sum(axis=0)
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
    return np.asarray(np.minimum(scores / np.maximum(able, 1)[:, None], 1.0))


def fit_name_model(called: Sequence[NamedObject], detector: str) -> NameModel:
    """Fits the model to objects with a name, by maximum likelihood.

    With an offset for each name, by ridge: names that are often wrong need more evidence, and a name that was seen
    seldom is as good as the mean. What a set has of a name is right or wrong together: n such objects weigh √n.
    """
    names = sorted({label_key(obj.name) for obj in called})
    logit = evidence_logit(np.array([obj.evidence for obj in called]))
    alike = Counter((obj.group, label_key(obj.name)) for obj in called)
    weight = np.array([alike[obj.group, label_key(obj.name)] ** -0.5 for obj in called])
    place = np.array([names.index(label_key(obj.name)) for obj in called], np.int64)
    sign = np.where([obj.right for obj in called], 1.0, -1.0)

    def loss(factors: F64) -> float:
        predicted = factors[0] * logit + factors[1] + factors[2:][place]
        return float((weight * np.logaddexp(0.0, -sign * predicted)).sum() + _RIDGE / 2 * (factors[2:] ** 2).sum())

    factor, offset, *offsets = minimize(loss, np.zeros(2 + len(names)), method="L-BFGS-B").x.tolist()
    counted = {name: [obj.right for obj in called if label_key(obj.name) == name] for name in names}
    return NameModel(
        detector=detector,
        sets=tuple(dict.fromkeys(obj.group for obj in called)),
        factor=round(factor, 3),
        offset=round(offset, 3),
        categories={
            name: NameCategory(offset=round(name_offset, 3), objects=len(counted[name]), right=sum(counted[name]))
            for name, name_offset in zip(names, offsets, strict=True)
        },
    )


def probabilities_left_out(called: Sequence[NamedObject]) -> F64:
    """Probabilities [K] that names are right, by models that saw no set of the object's kind."""
    predicted = np.zeros(len(called))
    kinds = np.array([obj.group.split("-")[0] for obj in called])
    for kind in set(kinds.tolist()):
        model = fit_name_model([obj for obj, obj_kind in zip(called, kinds, strict=True) if obj_kind != kind], "")
        for row in np.flatnonzero(kinds == kind).tolist():
            predicted[row] = model.probability(np.array([[called[row].evidence]]), [called[row].name])[0, 0]
    return predicted


def _held_out(named: Sequence[NamedObject], sure: F64) -> HeldOutNames:
    called = [obj for obj in named if obj.name]
    right, given = np.array([obj.right for obj in called], np.bool_), sure >= NAMED_FROM
    labels, names = Counter(obj.label for obj in called), Counter(obj.name for obj in called)
    pairs = sum(labels[label] * names[name] for label in labels for name in names if is_true_of(name, label))
    return HeldOutNames(
        objects=len(named),
        called=len(called),
        right=int(right.sum()),
        chance=round(pairs / max(len(called), 1), 3),
        given=int(given.sum()),
        given_right=int((given & right).sum()),
        expected=round(float(sure[given].sum()), 2),
    )
