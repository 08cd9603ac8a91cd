"""Second look for more names: choice of views, close-ups, and use of the detector's votes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.instances.discovery.lifting import lift_regions_of
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.instances.naming.naming import LEAST_SUGGESTED, MOST_SEEN, SEEN_PX
from fastsplat.service.perception.box_ops import box_iou
from fastsplat.service.perception.results import Detections
from fastsplat.service.scene.artefact.scene import Gaussians, Object, Objects
from fastsplat.service.scene.artefact.suggestions import Suggestion, ranked_suggestions
from fastsplat.service.scene.objects.objects import object_rows
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.training_views import training_size
from fastsplat_contract.geometry.camera import Camera, PosedCamera

F64 = NDArray[np.float64]

_NAMED_WORTH = 0.5  # worth of seeing a named object, relative to an unnamed one
_LOOSE_WORTH = 1.0  # worth of seeing all Gaussians without an object
_RIVALS = 0.5  # a text is clear only if other names have at most this share of its probability


@torch.no_grad()
def shares_seen(
    gaussians: Gaussians,
    objects: Objects,
    cameras: Sequence[PosedCamera],
    settings: DiscoverySettings,
    on_view: Callable[[int, int], None] = lambda done, total: None,
    *,
    backend: Backend = "cpu",
) -> F64:
    """Share of each object's Gaussians that each view sees, float64 [V, T + 1].

    Objects are in the order of the table; the last column is for Gaussians without an object.
    """
    place = np.full(max((obj.id for obj in objects.table), default=0) + 1, len(objects.table), np.int64)
    place[[obj.id for obj in objects.table]] = np.arange(len(objects.table))
    owner = place[object_rows(objects)]
    whole = np.maximum(np.bincount(owner, minlength=len(objects.table) + 1), 1)
    splats = splats_of(gaussians, device=device_of(backend))
    shares = np.zeros((len(cameras), len(objects.table) + 1))
    for number, posed in enumerate(cameras):
        camera = training_size(posed.camera, settings.max_side)
        viewmat = torch.from_numpy(posed.camera_from_world().astype(np.float32))
        nothing = np.zeros((camera.height, camera.width), np.int32)
        seen = lift_regions_of(splats, viewmat, camera, nothing, 0, backend=backend).pixels > SEEN_PX
        shares[number] = np.bincount(owner[seen], minlength=len(whole)) / whole
        on_view(number + 1, len(cameras))
    return shares


def choose_views(shares: F64, named: Sequence[bool], limit: int) -> list[int]:
    """Chooses at most `limit` views that together see most, unnamed objects first.

    Greedy: each view adds most to the sum over objects (named ones count half) of the share seen, halved for every
    earlier view that sees most of the object. Views that see nothing are not chosen.

    Args:
        shares: [V, T + 1], see `shares_seen`.
        named: of T objects, True for those with a name.
    """
    worth = np.array([*(_NAMED_WORTH if has_name else 1.0 for has_name in named), _LOOSE_WORTH])
    free = np.ones(len(shares), np.bool_)
    chosen: list[int] = []
    while free.any() and len(chosen) < limit:
        gains = np.where(free, shares @ worth, -1.0)
        best = int(gains.argmax())
        if gains[best] <= 0:
            break
        chosen.append(best)
        free[best] = False
        worth = np.where(shares[best] > MOST_SEEN, worth / 2, worth)
    return chosen


@dataclass(frozen=True)
class NamesAdded:
    """Objects after a second look."""

    objects: Objects
    named: tuple[int, ...]  # ids of objects now named by one of the texts
    suggested: tuple[int, ...]  # ids of others with one of the texts as a suggestion


def add_names(objects: Objects, sighted: Mapping[int, Mapping[str, float]], *, name_probability: float) -> NamesAdded:
    """Names objects by texts that are clear, and suggests the others.

    A text is clear from `name_probability`, 0..1, if no other text, name or suggestion of the object is nearly as
    probable. Names of persons and label maps stay; a detector's name is replaced only by a clear one, and becomes a
    suggestion.

    Args:
        sighted: probability, 0..1, of each text by object id; unknown ids are ignored.
    """
    named, suggested, table = [], [], []
    for obj in objects.table:
        texts = {name: sure for name, sure in sighted.get(obj.id, {}).items() if sure >= LEAST_SUGGESTED}
        changed = obj
        if texts and obj.source not in ("person", "given"):
            changed = _judged(obj, texts, name_probability)
        keys = {label_key(name) for name in texts}
        if changed is not obj and changed.name and label_key(changed.name) in keys:
            named.append(obj.id)
        elif changed is not obj and keys & {label_key(suggestion.name) for suggestion in changed.suggestions}:
            suggested.append(obj.id)
        table.append(changed)
    return NamesAdded(replace(objects, table=tuple(table)), tuple(named), tuple(suggested))


def _judged(obj: Object, texts: Mapping[str, float], name_probability: float) -> Object:
    by_key = {label_key(name): (name, sure) for name, sure in texts.items()}
    own_key = label_key(obj.name) if obj.name else ""
    best = max(by_key, key=lambda key: by_key[key][1])
    sure = by_key[best][1]
    rivals = [rival for key, (_, rival) in by_key.items() if key not in (best, own_key)]
    if own_key not in ("", best):
        rivals.append(max(obj.probability, by_key.get(own_key, ("", 0.0))[1]))
    extras = [suggestion for suggestion in obj.suggestions if suggestion.source]
    earlier = [(suggestion.name, suggestion.probability) for suggestion in obj.suggestions if not suggestion.source]
    before = [chance for name, chance in earlier if label_key(name) != best]
    clear = sure >= name_probability and max(rivals, default=0.0) <= _RIVALS * sure
    clear = clear and max(before, default=0.0) <= sure
    pool: dict[str, tuple[str, float]] = {}
    stated = ((obj.name, obj.probability),) if obj.name else ()
    for name, chance in (*stated, *earlier, *by_key.values()):
        first, most = pool.get(label_key(name), (name, 0.0))
        pool[label_key(name)] = (first, max(most, chance))
    if clear or own_key == best:
        name, most = pool.pop(best)
        probability = most if own_key == best else sure
        return replace(
            obj, name=name, source="detected", probability=probability, suggestions=_suggestions(pool.values(), extras)
        )
    if own_key:
        name, most = pool.pop(own_key)
        return replace(obj, probability=most, suggestions=_suggestions(pool.values(), extras))
    return replace(obj, suggestions=_suggestions(pool.values(), extras))


def _suggestions(names: Iterable[tuple[str, float]], extras: Sequence[Suggestion]) -> tuple[Suggestion, ...]:
    return ranked_suggestions([*(Suggestion(name, sure) for name, sure in names), *extras])


F32 = NDArray[np.float32]

_EDGE_PERCENT = 1.0  # percentage of an object's pixels outside of its box on each side, for robustness to strays
_LEAST_PX = 60  # least pixels of an object for a close-up
_CONTEXT = 2.0  # side of the close-up over the longer side of the object's box
_WHOLE = 0.9  # no close-up if it would show this share of a view's longer side


@dataclass(frozen=True)
class ObjectInView:
    """The place of an object in a view."""

    object_id: int
    box: F32  # [4], x1, y1, x2, y2 in pixels of the view
    pixels: int


def objects_in_map(object_map: NDArray[np.integer]) -> list[ObjectInView]:
    """Finds objects large enough for a close-up in an id map [H, W] (0: none)."""
    objects = []
    for object_id in np.unique(object_map[object_map > 0]).tolist():
        rows, columns = np.nonzero(object_map == object_id)
        if len(rows) >= _LEAST_PX:
            low, high = (_EDGE_PERCENT, 100 - _EDGE_PERCENT)
            (x1, x2), (y1, y2) = np.percentile(columns, [low, high]), np.percentile(rows, [low, high])
            objects.append(ObjectInView(object_id, np.array([x1, y1, x2 + 1, y2 + 1], np.float32), len(rows)))
    return objects


def best_positions(objects_by_view: Sequence[Sequence[ObjectInView]], limit: int) -> Mapping[int, tuple[int, ...]]:
    """Maps each object to the views with most of its pixels, best first.

    Args:
        objects_by_view: per view, the objects large enough for a close-up.
        limit: of views per object.
    """
    views: dict[int, list[tuple[int, int]]] = {}
    for position, objects in enumerate(objects_by_view):
        for obj in objects:
            views.setdefault(obj.object_id, []).append((-obj.pixels, position))
    return {object_id: tuple(position for _, position in sorted(pairs)[:limit]) for object_id, pairs in views.items()}


def closer_look(posed: PosedCamera, box: F32, largest_scale: float, side: int) -> tuple[PosedCamera, F32] | None:
    """Returns the camera of a close-up around a box, and the box in its picture.

    None if the close-up would be about the whole view.

    Args:
        posed: the view of the box.
        box: float32 [4], x1, y1, x2, y2 in its pixels.
        largest_scale: most pixels of the close-up per pixel of the view; at least 1 is used.
        side: most pixels of the close-up's longer side, unless this would make the scale less than 1.
    """
    camera = posed.camera
    reach = _CONTEXT / 2 * max(float(box[2] - box[0]), float(box[3] - box[1]))
    x, y = (float(box[0]) + float(box[2])) / 2, (float(box[1]) + float(box[3])) / 2
    left, top = max(0, int(x - reach)), max(0, int(y - reach))
    right, bottom = min(camera.width, int(np.ceil(x + reach))), min(camera.height, int(np.ceil(y + reach)))
    width, height = max(1, right - left), max(1, bottom - top)
    if max(width, height) > _WHOLE * max(camera.width, camera.height):
        return None
    scale = max(1.0, min(largest_scale, side / max(width, height)))
    part = Camera(width, height, camera.fx, camera.fy, camera.cx - left, camera.cy - top)
    closer = part.scaled_to(max(1, round(width * scale)), max(1, round(height * scale)))
    ratio = np.array([closer.width / width, closer.height / height] * 2, np.float32)
    return replace(posed, camera=closer), ((box - np.array([left, top, left, top], np.float32)) * ratio)


def votes_for(detections: Detections, box: F32, min_overlap: float) -> dict[str, float]:
    """Returns each label's best score among the boxes with IoU `min_overlap` or more with `box`."""
    overlap = box_iou(box[None], detections.boxes)[0]
    votes: dict[str, float] = {}
    for row in np.flatnonzero(overlap >= min_overlap):
        label = detections.labels[row]
        votes[label] = max(votes.get(label, 0.0), float(detections.scores[row]))
    return votes


def mean_votes(votes: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Averages scores by label over pictures of an object; a missing label counts as 0."""
    labels = {label for scores in votes for label in scores}
    return {label: sum(scores.get(label, 0.0) for scores in votes) / len(votes) for label in sorted(labels)}
