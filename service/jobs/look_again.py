"""Second search of a finished scene for texts, to name its objects.

The open-set detector sees renderings even if photos are kept: photos do not show edits, and may be missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fastsplat.service.capture.captures import Capture, CaptureReport
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.instances.naming.name_models import NameModel, load_name_model
from fastsplat.service.instances.naming.naming import NAMED_FROM, name_probability
from fastsplat.service.instances.naming.second_look import (
    add_names,
    best_positions,
    choose_views,
    closer_look,
    mean_votes,
    objects_in_map,
    shares_seen,
    votes_for,
)
from fastsplat.service.instances.scene_objects import NAME_OVERLAP, votes_of_views
from fastsplat.service.perception.detectors.open_detectors import (
    check_open_set_detector,
    of_open_set,
    open_open_set_detector,
)
from fastsplat.service.perception.label_maps.capture_detection import spread
from fastsplat.service.perception.label_maps.labelling import label_capture
from fastsplat.service.perception.onnx_session import use_backend
from fastsplat.service.perception.results import OpenSetDetector
from fastsplat.service.perception.segmenters.open_segmenter import open_segmenter
from fastsplat.service.query.edits.object_edits import with_label
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import ObjectScene, Scene, SceneFacts
from fastsplat.service.settings import Settings
from fastsplat.service.splat_import.pictures import Paint, Painter, render_pictures
from fastsplat.service.splatting.labels.blending import object_map
from fastsplat.service.splatting.training_views import training_size
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.jobs.look_again import FoundName, LookAgainResult

_CLOSER_SIDE = 640
"""Longer side of a close-up in pixels, at most the camera's resolution."""
_CANDIDATE_VIEWS = 60
"""Candidate cameras, evenly spread; each costs one rasterization."""
_PICTURE_SIDE = 1024
"""Longer side of the renderings in pixels, at most the camera's."""

STAGE = "looking"
_CHOOSING, _RENDERING, _DETECTING = 0.05, 0.1, 0.5
"""Progress of the stage after choosing views, rendering and detection."""


@dataclass(frozen=True)
class Sightings:
    """Detections of texts from the cameras `views`; `rendered`: in renderings, not photos.

    Attributes:
        found: by object id, the probability 0..1 of each text detected there.
        regions: number of detected regions.
        unmatched: number of regions that match no object.
        found_share: of objects that the detector calls by their names, 0..1.
    """

    texts: tuple[str, ...]
    views: tuple[str, ...]
    found: Mapping[int, Mapping[str, float]]
    regions: int
    unmatched: int
    rendered: bool = True
    found_share: float = 0.0


def look_for(
    index: SceneIndex,
    texts: Sequence[str],
    settings: Settings,
    folder: Path,
    progress: Progress,
    paint: Paint | None = None,
) -> Sightings:
    """Searches a scene for texts with the configured open-set detector.

    It looks at renderings from the few cameras that see most of the scene and of its unnamed objects; each segmented
    region votes for the object that it overlaps most (`count_votes`). Then each object is viewed alone in its best
    views.
    The larger probability counts: small objects are found only alone, coarse scenes better in large pictures.

    Args:
        texts: at least one.
        folder: empty; receives the pictures.
        progress: stage "looking"; may raise `CancelledError`.
        paint: renders a camera or a crop of its view; None: renderings of the scene.

    Raises:
        ModelUnavailableError: no open-set detector is configured, or a model is missing or damaged.
        InvalidInputError: a text that the detector cannot read.
        NotFoundError: no camera of the scene sees anything.
    """
    use_backend(settings.training.backend)
    check_open_set_detector(settings.perception)
    detector = open_open_set_detector(settings.perception, settings.models)
    open_segmenter(settings.perception, settings.models)  # a missing model fails before the rendering
    scene = index.objects.scene
    objects, backend = scene.objects, settings.training.backend
    candidates = _candidates(scene)
    shares = shares_seen(
        scene.gaussians,
        objects,
        candidates,
        settings.discovery,
        lambda done, total: _tell(progress, 0, _CHOOSING, done / total, f"choosing views {done}/{total}"),
        backend=backend,
    )
    chosen = choose_views(shares, [bool(obj.name) for obj in objects.table], settings.look_again.views)
    if not chosen:
        raise NotFoundError("none of the scene's own cameras sees anything of it", field="scene")
    cameras = [candidates[position] for position in sorted(chosen)]
    pictures = Painter(scene.gaussians, backend).picture if paint is None else paint
    views = render_pictures(
        pictures,
        cameras,
        folder,
        lambda done: _tell(progress, _CHOOSING, _RENDERING, done / len(cameras), f"pictures {done}/{len(cameras)}"),
    )
    none = np.zeros((0, 3))
    capture = Capture(
        views, none.astype(np.float32), none.astype(np.uint8), scene.scale, CaptureReport("images", len(views))
    )
    perception = settings.perception.model_copy(update={"max_views": 0})
    labelling = label_capture(
        capture,
        perception,
        settings.models,
        tuple(texts),
        lambda event: _tell(progress, _RENDERING, _DETECTING, event.fraction, event.message),
    )
    names = [entry.label for entry in labelling.dictionary.entries]
    looked_at = labelling.looked_at or ()
    used = [(views[number], labelling.regions[number]) for number in looked_at]
    used_names = tuple(cameras[number].name for number in looked_at)
    votes = votes_of_views(objects, scene.gaussians, used, len(names), settings.discovery, backend=backend)
    assert votes.voted is not None
    # With few views, one that names a partly visible object must not count for more than one.
    votes = replace(votes, able=np.maximum(votes.able, votes.voted))
    found = {
        obj.id: {name: float(sure) for name, sure in zip(names, row[1:], strict=True) if sure > 0}
        for obj, row in zip(objects.table, votes.mean_scores, strict=True)
        if row.any()
    }
    for object_id, closer in _look_closer(scene, cameras, pictures, detector, texts, settings, progress).items():
        whole = found.get(object_id, {})
        found[object_id] = {name: max(whole.get(name, 0.0), closer.get(name, 0.0)) for name in {**whole, **closer}}
    model = load_name_model(labelling.detector, settings.models)
    found, share = _probabilities(found, model), model.found_share or 0.0 if model else 0.0
    regions = sum(1 for view_regions in labelling.regions for region in view_regions.votes if region)
    _tell(progress, 0, 1, 1, f"{regions} found in {len(used)} views, {votes.unmatched} of them no object's")
    return Sightings(tuple(texts), used_names, found, regions, votes.unmatched, paint is None, share)


def _probabilities(scores: Mapping[int, Mapping[str, float]], model: NameModel | None) -> dict[int, dict[str, float]]:
    """Probabilities of texts, by object id, from their mean scores."""
    texts = sorted({text for found in scores.values() for text in found})
    rows = np.array([[0.0, *(found.get(text, 0.0) for text in texts)] for found in scores.values()])
    probabilities = name_probability(rows.reshape(-1, len(texts) + 1), texts, model)
    return {
        object_id: {text: float(sure) for text, sure in zip(texts, row[1:], strict=True) if sure > 0}
        for object_id, row in zip(scores, probabilities, strict=True)
    }


def _look_closer(
    scene: ObjectScene,
    cameras: Sequence[PosedCamera],
    paint: Paint,
    detector: OpenSetDetector,
    texts: Sequence[str],
    settings: Settings,
    progress: Progress,
) -> dict[int, dict[str, float]]:
    """Mean score of each text in close-ups, by object id."""
    if not settings.look_again.closer_views:
        return {}
    backend, sizes = settings.training.backend, {posed.name: posed.camera.width for posed in scene.cameras}
    boxes = [objects_in_map(object_map(scene, posed, backend=backend)) for posed in cameras]
    fixed = {obj.id for obj in scene.objects.table if obj.source in ("person", "given")}
    best = {i: views for i, views in best_positions(boxes, settings.look_again.closer_views).items() if i not in fixed}
    total, done, floor = sum(map(len, best.values())), 0, of_open_set(settings.perception).score_floor
    votes: dict[int, dict[str, float]] = {}
    for object_id, positions in best.items():
        object_votes = []
        for position in positions:
            posed = cameras[position]
            box = next(obj.box for obj in boxes[position] if obj.object_id == object_id)
            closer = closer_look(posed, box, sizes[posed.name] / posed.camera.width, _CLOSER_SIDE)
            if closer is not None:
                picture, _ = paint(closer[0])
                detections = detector.detect(picture, texts, floor)
                object_votes.append(votes_for(detections, closer[1], NAME_OVERLAP))
            done += 1
            _tell(progress, _DETECTING, 1, done / total, f"looking at object {object_id}, picture {done}/{total}")
        if object_votes:
            votes[object_id] = mean_votes(object_votes)
    return votes


def name_sightings(index: SceneIndex, sightings: Sightings, settings: Settings) -> tuple[Scene, LookAgainResult]:
    """Adds names, suggestions (see `add_names`) and searched texts to a scene.

    The result has no version name. `index` may be a later version than was searched: objects that it lacks get no name.
    """
    before = index.objects.scene
    added = add_names(before.objects, sightings.found, name_probability=NAMED_FROM)
    scene, table = before, []
    for obj in added.objects.table:
        if obj.id in added.named:
            scene, label = with_label(index, scene, obj.name)
            table.append(replace(obj, name=label))
        else:
            table.append(obj)
    named = {obj.id: obj for obj in table}
    result = LookAgainResult(
        version="",
        texts=sightings.texts,
        views=sightings.views,
        rendered=sightings.rendered,
        named=tuple(FoundName(i, named[i].name, named[i].probability) for i in added.named),
        suggested=tuple(
            FoundName(i, name, sure)
            for i in added.suggested
            for name, sure, *_ in named[i].suggestions
            if label_key(name) in {label_key(text) for text in sightings.found[i]}
        ),
        regions=sightings.regions,
        unmatched=sightings.unmatched,
    )
    facts = _searched(scene.facts, sightings.texts, sightings.found_share)
    if not (added.named or added.suggested):
        return replace(index.scene, facts=facts), result
    objects = replace(added.objects, table=tuple(table))
    return replace(scene, objects=objects, facts=facts), result


def _searched(facts: SceneFacts, texts: Sequence[str], found_share: float) -> SceneFacts:
    """Adds texts to the names that were searched for."""
    listed = facts.searched_for or ()
    known = {label_key(name) for name in listed}
    new = {text: found_share for text in texts if label_key(text) not in known}
    listed += tuple(new)
    return replace(facts, searched_names=len(listed), searched_for=listed, found_shares={**facts.found_shares, **new})


def _candidates(scene: Scene) -> list[PosedCamera]:
    positions = spread(len(scene.cameras), _CANDIDATE_VIEWS)
    cameras = [scene.cameras[position] for position in positions]
    return [replace(posed, camera=training_size(posed.camera, _PICTURE_SIDE)) for posed in cameras]


def _tell(progress: Progress, begin: float, end: float, done: float, message: str) -> None:
    progress(ProgressEvent(STAGE, begin + (end - begin) * done, message))
