"""Change detection from photos of another day, as contract messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.localization.changes import COMPARED_SIDE, Change, find_changes
from fastsplat.service.localization.later_views import LaterView
from fastsplat.service.localization.photo_placement import PlacedPhoto
from fastsplat.service.localization.photometric_refinement import compared
from fastsplat.service.query.language.sentences.change_sentences import change_sentence
from fastsplat.service.query.objects.solid_gaussians import grouped_rows, solid_rows
from fastsplat.service.query.objects.visibility import shows
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.geometry.object_prompts import PixelBox
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, vector3
from fastsplat_contract.photos.localization import PhotoDifference, SceneChange

F64 = NDArray[np.float64]

_TRIM = 0.02
"""Share of an object's Gaussians outside its box at either end of each axis."""
_WIDE = 0.35
"""Share of the place along two axes from which objects count as supports or room."""
_MARGIN = 0.1
_LOOKED = 2
"""Least number of scene photos that must have a place in view."""
_UPRIGHT = Quaternion(0.0, 0.0, 0.0, 1.0)

Seen = tuple[tuple[SceneChange, ...], tuple[int, ...], Mapping[int, tuple[PhotoDifference, ...]]]


def scene_changes(index: SceneIndex, placed: Sequence[PlacedPhoto], sizes: Sequence[tuple[int, int]]) -> Seen:
    """Changes on which two photos agree, where the scene's own photos looked.

    Also returns the objects that two photos should show, and each photo's differences, by number. `sizes` are width and
    height of each photo as sent.
    """
    found_places = [(number, placement.photo, placement.posed) for number, placement in enumerate(placed)]
    there = [(number, photo, posed) for number, photo, posed in found_places if photo is not None and posed is not None]
    numbers = [number for number, _, _ in there]
    boxes, place = _boxes(index)
    if len(numbers) < 2 or place is None:
        return (), (), {}
    views = []
    for _, photo, posed in there:
        comparison = compared(photo.picture, posed, index.geometry, valid=photo.valid, side=COMPARED_SIDE)
        views.append(LaterView(comparison, index.objects.map(comparison.posed).astype(np.int32)))
    reach = _WIDE * float((place[1] - place[0]).max())
    wide = frozenset(obj for obj, box in boxes.items() if np.sort(box[1] - box[0])[1] > reach)
    found = find_changes(views, boxes, _around([box for obj, box in boxes.items() if obj not in wide], place), wide)
    events = _where_looked(index.scene, found.events)
    changes = tuple(_scene_change(index, event, numbers) for event in events)
    differences: dict[int, list[PhotoDifference]] = {}
    for event in events:
        for region in event.regions:
            number = numbers[region.view]
            camera = views[region.view].comparison.posed.camera
            x, y = sizes[number][0] / camera.width, sizes[number][1] / camera.height
            left, top, right, bottom = region.box
            box = PixelBox(left * x, top * y, right * x, bottom * y)
            kind = "changed" if event.kind == "changed" else region.kind
            differences.setdefault(number, []).append(PhotoDifference(kind, box, event.probability))
    return changes, found.seen, {number: tuple(entries) for number, entries in differences.items()}


def _where_looked(scene: Scene, events: Sequence[Change]) -> list[Change]:
    """Drops events at places in view of fewer than two scene photos: the object may have been there before."""

    def looked(event: Change) -> bool:
        if event.after is None:
            return True
        middle = event.after.mean(axis=0)
        return sum(shows(posed, middle) for posed in scene.cameras) >= min(_LOOKED, len(scene.cameras))

    return [event for event in events if looked(event)]


def _boxes(index: SceneIndex) -> tuple[dict[int, F64], F64 | None]:
    """Corners (low, high), float64 [2, 3], of each visible object, and of all."""
    objects, means = index.objects, index.scene.gaussians.means
    solid = solid_rows(index.scene.gaussians)
    groups = grouped_rows(objects.owner, solid)
    boxes = {obj: np.quantile(means[rows].astype(np.float64), [_TRIM, 1 - _TRIM], axis=0) for obj, rows in groups}
    if not boxes:
        return {}, None
    corners = np.stack([*boxes.values()])
    return boxes, np.stack([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])


def _around(boxes: Sequence[F64], place: F64) -> F64:
    """Bounding box of objects with a margin; `place` without objects."""
    if not boxes:
        return place
    corners = np.stack(boxes)
    low, high = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    margin = _MARGIN * float((high - low).max())
    return np.stack([low - margin, high + margin])


def _scene_change(index: SceneIndex, change: Change, numbers: Sequence[int]) -> SceneChange:
    name = index.objects.get(change.object_id).name if change.object_id else ""
    distance = 0.0
    if change.kind == "moved" and change.before is not None and change.after is not None:
        distance = float(np.linalg.norm(change.after.mean(axis=0) - change.before.mean(axis=0)))
    return SceneChange(
        kind=change.kind,
        object_id=change.object_id,
        name=name,
        probability=change.probability,
        distance=distance,
        before=_box(change.before),
        after=_box(change.after),
        photos=tuple(numbers[row] for row in change.views),
        sentence=change_sentence(change.kind, change.object_id, name, distance, index.scene.scale == "METRIC"),
    )


def _box(corners: F64 | None) -> Box | None:
    """World-axis-aligned."""
    if corners is None:
        return None
    return Box(Pose(vector3(corners.mean(axis=0)), _UPRIGHT), vector3(corners[1] - corners[0]))
