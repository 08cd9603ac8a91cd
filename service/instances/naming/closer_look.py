"""Close-up views of objects, and detector votes for the boxes that match the object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.box_ops import box_iou
from fastsplat.service.perception.results import Detections
from fastsplat_contract.geometry.camera import Camera, PosedCamera

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
