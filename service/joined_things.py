"""What photos that join a finished scene show of its things: looked at as the first ones were, and put into the scene.

Names, ids and edits of people stay. What no new photo shows stays as it is, to the bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.types import Capture, CaptureReport, View
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.common.progress import Progress
from fastsplat.service.instances.joined_views import JoinedViews, with_joined_views
from fastsplat.service.instances.name_calibration import name_probability
from fastsplat.service.instances.naming import NAMED_FROM, name_things
from fastsplat.service.instances.scene_things import votes_of_views
from fastsplat.service.instances.second_look import add_names
from fastsplat.service.perception.detectors.open_detectors import closed_set_labels
from fastsplat.service.perception.labelling import label_capture
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.perception.types import Labelling
from fastsplat.service.query.edits.thing_edits import with_label
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.types import Scene, Things
from fastsplat.service.settings import Settings
from fastsplat.service.things_of_photos import described_things


def look_at_joined(scene: Scene, views: Sequence[View], settings: Settings, progress: Progress) -> Labelling | None:
    """What the models of a job that makes a scene see in photos that join one, asked for the names that the scene was
    searched for; None where it has no things, or they are those of label maps that came with its photos.

    Args:
        scene: that they join.
        views: the photos.
        settings: of all rooms.
        progress: hears of the stage "perception"; may raise `CancelledError`.

    Raises:
        ModelUnavailableError: a model of the settings is missing or damaged.
    """
    masks = settings.discovery.proposes(given_labels=scene.quality.get("label_source") == "given")
    if scene.things is None or not (masks or scene.quality.get("label_source") == "detected"):
        return None
    none = np.zeros((0, 3))
    report = CaptureReport("images", len(views))
    capture = Capture(tuple(views), none.astype(np.float32), none.astype(np.uint8), scene.scale, report)
    names = _searched(scene, settings)
    return label_capture(capture, settings.perception, settings.models, names, progress, masks=masks)


def _searched(scene: Scene, settings: Settings) -> tuple[str, ...]:
    """The names that a scene was searched for, as far as the models know them; none: whatever is there."""
    names = tuple(str(name) for name in scene.quality.get("searched_for") or ())
    if settings.perception.open_set_detector:
        return names
    known = set(map(label_key, closed_set_labels(settings.perception)))
    able = tuple(name for name in names if label_key(name) in known)
    return () if known <= set(map(label_key, able)) else able


def with_joined_things(
    scene: Scene,
    views: Sequence[View],
    labelling: Labelling,
    changed: NDArray[np.bool_],
    born: NDArray[np.bool_],
    settings: Settings,
) -> Scene:
    """The scene with what its last photos show of its things.

    A mask that is no known thing and shows mostly what the scene had nothing of is a new thing. What the views call a
    known thing counts with what those of before called it, each view as much.

    Args:
        scene: with the photos' cameras as its last.
        views: the photos, in its frame.
        labelling: of the photos, see `look_at_joined`.
        changed, born: see `JoinedViews`.
        settings: of all rooms.

    Raises:
        ModelUnavailableError: a model of the settings is missing or damaged.
        LimitExceededError: as `with_new_thing`.
    """
    discovery, backend = settings.discovery, settings.training.backend
    masks = labelling.masks or tuple(own.masks() for own in labelling.regions)
    scene, new = with_joined_views(scene, JoinedViews(views, masks, changed, born), discovery, backend=backend)
    things = scene.things
    assert things is not None
    names = [entry.label for entry in labelling.dictionary.entries]
    used = [(view, own) for view, own in zip(views, labelling.regions, strict=True) if own.votes]
    if used:
        votes = votes_of_views(things, scene.gaussians, used, len(names), discovery, backend=backend)
        named = {each.id: each for each in name_things(things, votes, names, "detected").table}
        sure = name_probability(votes.mean_scores, names)
        first = len(scene.cameras) - len(views)
        sighted = {
            thing.id: _together(things, place, first, dict(zip(names, row[1:].tolist(), strict=True)), able)
            for place, (thing, row, able) in enumerate(zip(things.table, sure, votes.able.tolist(), strict=True))
            if able
        }
        known = add_names(things, sighted, name_probability=NAMED_FROM).things
        table = tuple(named[thing.id] if thing.id in new else thing for thing in known.table)
        scene = _with_names(replace(scene, things=replace(things, table=table)), settings)
    return _described(scene, new, views, settings)


def _together(things: Things, place: int, first: int, sure: dict[str, float], able: float) -> dict[str, float]:
    """How probable names are by all views, of what `able` more say of a thing; the scene's cameras from `first` on are
    theirs."""
    thing = things.table[place]
    before = sum(number < first for number in (*thing.proposed_in, *thing.missed_in))
    stated = {label_key(each.name): each.probability for each in thing.suggestions if not each.source}
    if thing.name:
        stated[label_key(thing.name)] = thing.probability
    return {
        name: (before * stated.get(label_key(name), 0.0) + able * now) / (before + able)
        for name, now in sure.items()
        if now > 0
    }


def _with_names(scene: Scene, settings: Settings) -> Scene:
    """The scene whose dictionary has the names of all its things, which take the dictionary's spelling."""
    assert scene.things is not None
    missing = [thing for thing in scene.things.table if thing.name and scene.dictionary.id_of(thing.name) is None]
    if not missing:
        return scene
    index = SceneIndex(scene, open_text_encoder(scene.text_encoder[0], settings.models), settings.query)
    spelled = {}
    for thing in missing:
        scene, spelled[thing.id] = with_label(index, scene, thing.name)
    things = scene.things
    assert things is not None
    table = tuple(replace(thing, name=spelled.get(thing.id, thing.name)) for thing in things.table)
    return replace(scene, things=replace(things, table=table))


def _described(scene: Scene, new: Sequence[int], views: Sequence[View], settings: Settings) -> Scene:
    things = scene.things
    if things is None or not new or settings.discovery.things == "off":
        return scene
    alone = replace(things, table=tuple(thing for thing in things.table if thing.id in new), parts=None, groups=())
    private = settings.photos.keep == "off"
    told = described_things(alone, scene.gaussians, views, settings, lambda done, total: None, private=private)
    described = {thing.id: thing for thing in told.table}
    table = tuple(described.get(thing.id, thing) for thing in things.table)
    return replace(scene, things=replace(things, table=table))
