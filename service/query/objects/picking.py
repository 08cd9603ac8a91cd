"""Picking of an object, its part or its group at a place, with probabilities.

The probability of a level is p(l) = w(l) c(l) a(l) / Σ over the existing levels:
- c(l): `consensus`, the share of views that proposed it among those that see it,
- a(l): agreement with the place: at a pixel, the share of the 7×7 pixels around it; in a box, the IoU of mask and box;
  at a point, the share of the Gaussians there,
- w(l): prior of the level, see `_MEANT`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from fastsplat.service.query.objects.object_index import SceneObjects
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import Vector3
from fastsplat_contract.messages.objects import AskedLevel, PickedLevel, PickLevel, Pixel, PixelBox

_MEANT: dict[PickLevel, float] = {"part": 0.25, "object": 1.0, "group": 0.25}
"""Prior of each level relative to an object.

Discovery chose objects by more evidence than one place has, so another level wins only if the place contradicts the
object."""
_LEAST = 1e-3
"""Consensus of what hardly any view proposed."""
_AROUND_PX = 3
"""Pixels around a click that may have been meant."""

Agreement = Callable[[int], float]
"""Agreement of a part, object or group with a place, 0..1, by its id."""


def check_pixel(posed: PosedCamera, pixel: Pixel, field: str = "pixel") -> None:
    """Raises InvalidInputError for a pixel outside of a camera's picture."""
    width, height = posed.camera.width, posed.camera.height
    if not (0 <= pixel.x < width and 0 <= pixel.y < height):
        raise InvalidInputError(
            f"a pixel at ({pixel.x:g}, {pixel.y:g}) in a picture of {width}×{height}",
            field=field,
            limit=f"0 to below {width} and 0 to below {height}",
            hint="Send pixels of the camera's own picture.",
        )


def check_box(posed: PosedCamera, box: PixelBox) -> None:
    """Raises InvalidInputError for a box outside of a camera's picture, or without area."""
    width, height = posed.camera.width, posed.camera.height
    if not (0 <= box.left < box.right <= width and 0 <= box.top < box.bottom <= height):
        raise InvalidInputError(
            f"a box from ({box.left:g}, {box.top:g}) to ({box.right:g}, {box.bottom:g}) in a picture of "
            f"{width}×{height}",
            field="box",
            limit=f"left below right, at most {width}; top below bottom, at most {height}",
            hint="Send pixels of the camera's own picture.",
        )


def pick_pixel(objects: SceneObjects, posed: PosedCamera, pixel: Pixel) -> tuple[PickedLevel, ...]:
    """Picks part, object and group at a pixel.

    Raises:
        InvalidInputError: the pixel is outside the picture.
        NotFoundError: no object is there.
    """
    check_pixel(posed, pixel)
    x, y = int(pixel.x), int(pixel.y)
    object_id = int(objects.map(posed)[y, x])
    if not object_id:
        raise _nothing(f"at the pixel ({pixel.x:g}, {pixel.y:g})", "pixel")
    part_ids = _part_ids(objects, object_id)
    part_id = int(objects.part_map(posed)[y, x]) if part_ids else 0
    around = np.s_[max(0, y - _AROUND_PX) : y + _AROUND_PX + 1, max(0, x - _AROUND_PX) : x + _AROUND_PX + 1]
    return _levels(
        objects,
        object_id,
        part_id if part_id in part_ids else 0,
        lambda candidate: float(objects.mask(posed, (candidate,))[around].mean()),
    )


def pick_box(objects: SceneObjects, posed: PosedCamera, box: PixelBox) -> tuple[PickedLevel, ...]:
    """Picks the object and part with the largest IoU with a box; errors as `pick_pixel`."""
    check_box(posed, box)
    left, top = int(box.left), int(box.top)
    right, bottom = max(int(np.ceil(box.right)), left + 1), max(int(np.ceil(box.bottom)), top + 1)

    def overlap(candidate: int) -> float:
        mask = objects.mask(posed, (candidate,))
        inside = int(mask[top:bottom, left:right].sum())
        return inside / (int(mask.sum()) + (right - left) * (bottom - top) - inside)

    ids = np.unique(objects.map(posed)[top:bottom, left:right])
    object_id = max((int(candidate) for candidate in ids if candidate), key=overlap, default=0)
    if not object_id:
        raise _nothing("in the box", "box")
    part_id = max(_part_ids(objects, object_id), key=overlap, default=0)
    return _levels(objects, object_id, part_id if part_id and overlap(part_id) else 0, overlap)


def pick_point(objects: SceneObjects, point: Vector3) -> tuple[PickedLevel, ...]:
    """Picks at the nearest visible Gaussian, see `rows_at`; errors as `pick_pixel`."""
    near = objects.rows_at(point)
    object_id = int(objects.owner[near[0]]) if len(near) else 0
    if not object_id:
        raise _nothing(f"at the point ({point.x:g}, {point.y:g}, {point.z:g})", "point")
    part_id = int(objects.part_owner[near[0]])
    return _levels(
        objects,
        object_id,
        part_id if part_id in _part_ids(objects, object_id) else 0,
        lambda candidate: float(objects.rows((candidate,))[near].mean()),
    )


def chosen_level(levels: Sequence[PickedLevel], level_name: AskedLevel) -> PickedLevel:
    """Selects the requested level (or raises NotFoundError), or the likeliest; objects win ties."""
    if level_name == "likeliest":
        return max(levels, key=lambda level: (level.probability, level.level == "object"))
    for option in levels:
        if option.level == level_name:
            return option
    hint = f"There is: {', '.join(level.level for level in levels)}."
    raise NotFoundError(f"there is no {level_name} at this place", field="level", hint=hint)


def _part_ids(objects: SceneObjects, object_id: int) -> tuple[int, ...]:
    return tuple(part.id for part in objects.present_parts if part.parent == object_id)


def _levels(objects: SceneObjects, object_id: int, part_id: int, agreement: Agreement) -> tuple[PickedLevel, ...]:
    consensus = {obj.id: obj.consensus for obj in (*objects.present, *objects.present_parts)}
    # Of several groups, take the one with the highest consensus, then the smallest.
    groups = [group for group in objects.groups.values() if object_id in group.members]
    group = max(groups, key=lambda group: (group.consensus, -len(group.members)), default=None)
    scores: dict[tuple[PickLevel, int], float] = {("object", object_id): consensus[object_id]}
    if part_id:
        scores = {("part", part_id): consensus[part_id], **scores}
    if group is not None:
        scores["group", group.id] = group.consensus
    scores = {
        (level, level_id): _MEANT[level] * max(sure, _LEAST) * agreement(level_id)
        for (level, level_id), sure in scores.items()
    }
    total = sum(scores.values())
    members = () if group is None else group.members
    return tuple(
        PickedLevel(level, level_id, members if level == "group" else (), score / total)
        for (level, level_id), score in scores.items()
    )


def _nothing(where: str, field: str) -> NotFoundError:
    return NotFoundError(
        f"there is no object {where}", field=field, hint="Pick where the scene's pictures show something."
    )
