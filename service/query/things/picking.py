"""What is at a place: a thing, the part of it there, the group that it is in; and which of these levels is meant.

The probability that a level is meant is p(l) = w(l) c(l) a(l) / Σ over the levels that are there, where

- c(l) is the share of the views that see it in which the level's part, thing or group was proposed (`consensus`),
- a(l) is how far it agrees with the place: at a pixel, the share of the 7×7 pixels around it that are of it; in a box,
  the intersection over union of its mask and the box; at a point, the share of the Gaussians there that are of it,
- w(l) is how often people mean a level, whatever is there, see `_MEANT`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from fastsplat.service.query.things.thing_index import SceneThings
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import Vector3
from fastsplat_contract.messages.things import AskedLevel, PickedLevel, PickLevel, Pixel, PixelBox

_MEANT: dict[PickLevel, float] = {"part": 0.25, "thing": 1.0, "group": 0.25}
"""How often a level is meant beside a thing. Discovery has chosen what is a thing by more evidence than one place has;
so another level is likelier only where the place speaks against the thing."""
_LEAST = 1e-3
"""Consensus of what hardly any view proposed."""
_AROUND_PX = 3
"""Pixels on each side of one within which a click may have been meant."""

Agreement = Callable[[int], float]
"""How far a part, thing or group agrees with a place, 0..1, by its id."""


def pick_pixel(things: SceneThings, posed: PosedCamera, pixel: Pixel) -> tuple[PickedLevel, ...]:
    """The levels of what a view shows at a pixel: the part, if there is one, the thing, the group, if there is one.

    Raises:
        InvalidInputError: the pixel is outside the picture.
        NotFoundError: no thing is there.
    """
    width, height = posed.camera.width, posed.camera.height
    if not (0 <= pixel.x < width and 0 <= pixel.y < height):
        raise InvalidInputError(
            f"a pixel at ({pixel.x:g}, {pixel.y:g}) in a picture of {width}×{height}",
            field="pixel",
            limit=f"0 to below {width} and 0 to below {height}",
            hint="Send pixels of the camera's own picture.",
        )
    x, y = int(pixel.x), int(pixel.y)
    thing_id = int(things.map(posed)[y, x])
    if not thing_id:
        raise _nothing(f"at the pixel ({pixel.x:g}, {pixel.y:g})", "pixel")
    part_ids = _part_ids(things, thing_id)
    part_id = int(things.part_map(posed)[y, x]) if part_ids else 0
    around = np.s_[max(0, y - _AROUND_PX) : y + _AROUND_PX + 1, max(0, x - _AROUND_PX) : x + _AROUND_PX + 1]
    return _levels(
        things,
        thing_id,
        part_id if part_id in part_ids else 0,
        lambda each: float(things.mask(posed, (each,))[around].mean()),
    )


def pick_box(things: SceneThings, posed: PosedCamera, box: PixelBox) -> tuple[PickedLevel, ...]:
    """The levels of the thing whose mask overlaps a box of a view best, by intersection over union, as `pick_pixel`;
    the part is the one of the thing that overlaps the box best.

    Raises:
        InvalidInputError: the box is outside the picture, or has no area.
        NotFoundError: no thing is there.
    """
    width, height = posed.camera.width, posed.camera.height
    if not (0 <= box.left < box.right <= width and 0 <= box.top < box.bottom <= height):
        raise InvalidInputError(
            f"a box from ({box.left:g}, {box.top:g}) to ({box.right:g}, {box.bottom:g}) in a picture of "
            f"{width}×{height}",
            field="box",
            limit=f"left below right, at most {width}; top below bottom, at most {height}",
            hint="Send pixels of the camera's own picture.",
        )
    left, top = int(box.left), int(box.top)
    right, bottom = max(int(np.ceil(box.right)), left + 1), max(int(np.ceil(box.bottom)), top + 1)

    def overlap(each: int) -> float:
        mask = things.mask(posed, (each,))
        inside = int(mask[top:bottom, left:right].sum())
        return inside / (int(mask.sum()) + (right - left) * (bottom - top) - inside)

    shown = np.unique(things.map(posed)[top:bottom, left:right])
    thing_id = max((int(each) for each in shown if each), key=overlap, default=0)
    if not thing_id:
        raise _nothing("in the box", "box")
    part_id = max(_part_ids(things, thing_id), key=overlap, default=0)
    return _levels(things, thing_id, part_id if part_id and overlap(part_id) else 0, overlap)


def pick_point(things: SceneThings, point: Vector3) -> tuple[PickedLevel, ...]:
    """The levels of what is at a point of the world, as `pick_pixel`: of the nearest visible Gaussian there, see
    `SceneThings.rows_at`.

    Raises:
        InvalidInputError: the point is not finite.
        NotFoundError: no thing is there.
    """
    near = things.rows_at(point)
    thing_id = int(things.owner[near[0]]) if len(near) else 0
    if not thing_id:
        raise _nothing(f"at the point ({point.x:g}, {point.y:g}, {point.z:g})", "point")
    part_id = int(things.part_owner[near[0]])
    return _levels(
        things,
        thing_id,
        part_id if part_id in _part_ids(things, thing_id) else 0,
        lambda each: float(things.rows((each,))[near].mean()),
    )


def chosen_level(levels: Sequence[PickedLevel], asked: AskedLevel) -> PickedLevel:
    """The level that is asked for, or the likeliest; of levels as likely the thing.

    Raises:
        NotFoundError: there is no such level.
    """
    if asked == "likeliest":
        return max(levels, key=lambda each: (each.probability, each.level == "thing"))
    for each in levels:
        if each.level == asked:
            return each
    raise NotFoundError(
        f"there is no {asked} at this place",
        field="level",
        hint=f"There is: {', '.join(each.level for each in levels)}.",
    )


def _part_ids(things: SceneThings, thing_id: int) -> tuple[int, ...]:
    return tuple(part.id for part in things.present_parts if part.parent == thing_id)


def _levels(things: SceneThings, thing_id: int, part_id: int, agreement: Agreement) -> tuple[PickedLevel, ...]:
    consensus = {thing.id: thing.consensus for thing in (*things.present, *things.present_parts)}
    # Of several groups the one that most views took for one, of these the smallest.
    group = max(
        (group for group in things.groups.values() if thing_id in group.members),
        key=lambda one: (one.consensus, -len(one.members)),
        default=None,
    )
    scores: dict[tuple[PickLevel, int], float] = {("thing", thing_id): consensus[thing_id]}
    if part_id:
        scores = {("part", part_id): consensus[part_id], **scores}
    if group is not None:
        scores["group", group.id] = group.consensus
    scores = {
        (level, each): _MEANT[level] * max(sure, _LEAST) * agreement(each) for (level, each), sure in scores.items()
    }
    total = sum(scores.values())
    members = () if group is None else group.members
    return tuple(
        PickedLevel(level, each, members if level == "group" else (), score / total)
        for (level, each), score in scores.items()
    )


def _nothing(where: str, field: str) -> NotFoundError:
    return NotFoundError(
        f"there is no thing {where}", field=field, hint="Pick where the scene's pictures show something."
    )
