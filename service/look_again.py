"""Looking again: a finished scene is searched for texts, by an open-set detector in a few views, to name its things.

The capture's photos are not kept with a scene, so what the detector sees are renderings from the scene's own cameras.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fastsplat.service.capture.types import Capture, CaptureReport
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.instances.scene_things import votes_of_views
from fastsplat.service.instances.second_look import add_names, choose_views, shares_seen
from fastsplat.service.perception import label_capture
from fastsplat.service.perception.capture_detection import spread
from fastsplat.service.perception.detectors import check_open_set_detector, open_open_set_detector
from fastsplat.service.query import SceneIndex
from fastsplat.service.query.thing_edits import with_label
from fastsplat.service.scene import Scene
from fastsplat.service.settings import Settings
from fastsplat.service.splat_import.pictures import render_pictures
from fastsplat.service.splatting.training_views import training_size
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.look_again_messages import FoundName, LookAgainResult

STAGE = "looking"
_CHOOSING, _RENDERING, _DETECTING = 0.1, 0.2, 0.95
"""Of the stage's progress, after the views are chosen, the pictures rendered, the texts searched for."""


@dataclass(frozen=True)
class Sightings:
    """What a detector found of some texts.

    Attributes:
        texts: that were looked for.
        views: names of the cameras from which it looked.
        found: for ids of things the probability of each text that anything was found of there, 0..1.
        regions: number of regions that were found.
        unmatched: number of those that are no thing's.
    """

    texts: tuple[str, ...]
    views: tuple[str, ...]
    found: Mapping[int, Mapping[str, float]]
    regions: int
    unmatched: int


def look_for(
    index: SceneIndex, texts: Sequence[str], settings: Settings, folder: Path, progress: Progress
) -> Sightings:
    """What the configured open-set detector finds of some texts in a scene.

    It looks at renderings from the few cameras that see most of the scene, and of its unnamed things; what it finds
    there are regions, by the segmenter, and each region votes for the thing that it overlaps most (`count_votes`).

    Args:
        index: of the scene.
        texts: at least one.
        settings: of all rooms.
        folder: empty; gets the pictures.
        progress: hears of the stage "looking"; may raise `CancelledError`.

    Raises:
        ModelUnavailableError: no open-set detector is configured, or a model of the settings is missing or damaged.
        InvalidInputError: a text that the detector cannot read.
        NotFoundError: the scene has no camera that sees anything.
    """
    check_open_set_detector(settings.perception)
    open_open_set_detector(settings.perception, settings.models)  # a missing model fails before the rendering
    scene = index.things.scene
    things, backend = scene.things, settings.training.backend
    assert things is not None
    candidates = _candidates(scene, settings)
    shares = shares_seen(
        scene.gaussians,
        things,
        candidates,
        settings.discovery,
        lambda done, total: _tell(progress, 0, _CHOOSING, done / total, f"choosing views {done}/{total}"),
        backend=backend,
    )
    chosen = choose_views(shares, [bool(thing.name) for thing in things.table], settings.look_again.views)
    if not chosen:
        raise NotFoundError("none of the scene's own cameras sees anything of it", field="scene")
    cameras = [candidates[position] for position in sorted(chosen)]
    views = render_pictures(
        scene.gaussians,
        cameras,
        folder,
        lambda done: _tell(progress, _CHOOSING, _RENDERING, done / len(cameras), f"pictures {done}/{len(cameras)}"),
        backend=backend,
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
    used = list(zip(views, labelling.regions, strict=True))
    votes = votes_of_views(things, scene.gaussians, used, len(names), settings.discovery, backend=backend)
    found = {
        thing.id: {name: float(sure) for name, sure in zip(names, row[1:], strict=True) if sure > 0}
        for thing, row in zip(things.table, votes.probability, strict=True)
        if row.any()
    }
    regions = sum(1 for own in labelling.regions for region in own.votes if region)
    _tell(progress, 0, 1, 1, f"{regions} found in {len(views)} renderings, {votes.unmatched} of them no thing's")
    return Sightings(tuple(texts), tuple(posed.name for posed in cameras), found, regions, votes.unmatched)


def name_sightings(index: SceneIndex, sightings: Sightings, settings: Settings) -> tuple[Scene, LookAgainResult]:
    """The scene with the names and suggestions of a look, see `add_names`, and with its texts among the names that it
    was searched for; and what that changed, without the new version's name.

    Args:
        index: of the scene as it is now, which may be a later version than the one that was looked at: what it has no
            more of stays without a name.
        sightings: see `look_for`.
        settings: of all rooms.
    """
    before = index.things.scene
    assert before.things is not None
    added = add_names(before.things, sightings.found, settings.discovery)
    scene, table = before, []
    for thing in added.things.table:
        if thing.id in added.named:
            scene, label = with_label(index, scene, thing.name, ())
            table.append(replace(thing, name=label))
        else:
            table.append(thing)
    named = {thing.id: thing for thing in table}
    result = LookAgainResult(
        version="",
        texts=sightings.texts,
        views=sightings.views,
        rendered=True,
        named=tuple(FoundName(i, named[i].name, named[i].probability) for i in added.named),
        suggested=tuple(
            FoundName(i, name, sure)
            for i in added.suggested
            for name, sure in named[i].suggestions
            if label_key(name) in {label_key(text) for text in sightings.found[i]}
        ),
        regions=sightings.regions,
        unmatched=sightings.unmatched,
    )
    quality = {**scene.quality, **_searched(before, sightings.texts)}
    if not (added.named or added.suggested):
        return replace(index.scene, quality=quality), result
    things = replace(added.things, table=tuple(table))
    mode = "things" if added.named else scene.label_mode
    return replace(scene, things=things, label_mode=mode, quality=quality), result


def _searched(scene: Scene, texts: Sequence[str]) -> dict[str, object]:
    """How many names the scene was searched for, and which, with some more. Of scenes of earlier releases the number is
    known alone, and that the names of the dictionary are among them."""
    count, names = scene.quality.get("searched_names"), scene.quality.get("searched_for")
    listed = [str(name) for name in names] if isinstance(names, (list, tuple)) else []
    before = count if isinstance(count, int) else len(listed)
    known = {label_key(name) for name in listed}
    if before > len(listed):
        known |= {label_key(entry.label) for entry in scene.dictionary.entries}
    new = [text for text in texts if label_key(text) not in known]
    return {"searched_names": before + len(new), "searched_for": [*listed, *new]}


def _candidates(scene: Scene, settings: Settings) -> list[PosedCamera]:
    positions = spread(len(scene.cameras), settings.look_again.candidates)
    side = settings.look_again.picture_side
    cameras = [scene.cameras[position] for position in positions]
    return [replace(posed, camera=training_size(posed.camera, side)) for posed in cameras]


def _tell(progress: Progress, begin: float, end: float, done: float, message: str) -> None:
    progress(ProgressEvent(STAGE, begin + (end - begin) * done, message))
