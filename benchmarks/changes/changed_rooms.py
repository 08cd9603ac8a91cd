"""Drawn rooms some days later: objects that were taken away, moved or put there, and ten new photos of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.rooms.arranging import Placed, Room, extent
from benchmarks.rooms.drawing import Studio, camera_of, room_of
from benchmarks.rooms.models.tableware import Random
from benchmarks.rooms.pictures import Faults, photo_of
from benchmarks.rooms.shapes import F64, Meshes, placed, resting
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import look_at
from fastsplat_contract.photos.localization import ChangeKind

PHOTOS = 10
_MOST_CHANGES = 6
_LARGEST_EV, _LARGEST_BALANCE = 0.7, 0.04
_NEAREST, _FARTHEST = 0.08, 0.45
"""Meters that an object is moved by; times three where objects are as large as chairs."""
_GAP = 0.02
_TRIES = 200


@dataclass(frozen=True)
class TrueChange:
    """What became of an object.

    Attributes:
        kind: "gone", "moved" or "new".
        label: what it is.
        before, after: float64 [2, 3], lowest and highest corners, meters; None where it was or is nowhere.
    """

    kind: ChangeKind
    label: str
    before: F64 | None
    after: F64 | None


@dataclass(frozen=True)
class LaterPhotos:
    """A room's photos of another day.

    Attributes:
        photos: uint8 [H, W, 3] each.
        posed: where they were taken, in the room's frame.
        changes: what is not as it was.
    """

    photos: tuple[NDArray[np.uint8], ...]
    posed: tuple[PosedCamera, ...]
    changes: tuple[TrueChange, ...]


def later_photos(name: str, seed: int, changes: int, views: int = PHOTOS) -> LaterPhotos:
    """Photos from another path, in light of up to ±.7 EV, of a room with some changes.

    Args:
        name: of the room, see `benchmarks.rooms.drawing`.
        seed: of changes, path and light.
        changes: how many objects change; 0 for none.
        views: how many photos.
    """
    room, light_seed = room_of(name)
    rng = np.random.default_rng([light_seed, seed, 7])
    later, true_changes = _changed(room, name, rng, changes)
    studio, camera = Studio(later, light_seed), camera_of()
    posed = tuple(PosedCamera(camera, pose, f"later/{number}") for number, pose in enumerate(_path(room, rng, views)))
    photos = tuple(photo_of(studio.draw(posed_camera).light, _faults(rng), rng) for posed_camera in posed)
    return LaterPhotos(photos, posed, true_changes)


def _faults(rng: Random) -> Faults:
    red, blue = rng.uniform(-_LARGEST_BALANCE, _LARGEST_BALANCE, 2)
    ev, blur = float(rng.uniform(-_LARGEST_EV, _LARGEST_EV)), float(rng.uniform(0.0, 0.6))
    return Faults(ev, (1 + float(red), 1.0, 1 + float(blue)), blur, float(rng.uniform(0.08, 0.2)), noise=True)


def _path(room: Room, rng: Random, views: int) -> list[F64]:
    """Between the places of the first photos, a little aside of them, towards what they look at."""
    order = np.sort(rng.choice(len(room.poses), min(views, len(room.poses)), replace=False))
    low, high = extent([mesh for obj in room.objects if not obj.surface for mesh in obj.meshes])
    middle, poses = (low + high) / 2, []
    for pose in (room.poses[row] for row in order.tolist()):
        eye, forward = pose[:3, 3], pose[:3, 2]
        reach = float(np.dot(middle - eye, forward))
        aside = eye + rng.normal(0, 0.06 * reach, 3)
        poses.append(look_at(aside.tolist(), (eye + reach * forward + rng.normal(0, 0.02 * reach, 3)).tolist()))
    return poses


def _changed(room: Room, name: str, rng: Random, count: int) -> tuple[Room, tuple[TrueChange, ...]]:
    objects: list[Placed | None] = list(room.objects)
    free = [number for number, obj in enumerate(objects) if obj is not None and _movable(room, number)]
    chosen = rng.permutation(free).tolist()[: min(count, _MOST_CHANGES)]
    new_objects = _foreign_objects(name, rng)
    true_changes: list[TrueChange] = []
    for number in chosen:
        kind = str(rng.choice(["gone", "moved", "new"]))
        obj = room.objects[number]
        standing = [obj for obj in objects if obj is not None]
        if kind == "new" and new_objects:
            new = new_objects.pop()
            put = _somewhere(new, [*standing], room, rng, None)
            if put is not None:
                objects.append(replace(new, meshes=put))
                true_changes.append(TrueChange("new", new.label, None, _box(put)))
            continue
        if kind == "moved" and _rests(obj, room):
            put = _somewhere(obj, [neighbor for neighbor in standing if neighbor is not obj], room, rng, obj)
            if put is not None:
                objects[number] = replace(obj, meshes=put)
                true_changes.append(TrueChange("moved", obj.label, _box(obj.meshes), _box(put)))
            continue
        objects[number] = None
        true_changes.append(TrueChange("gone", obj.label, _box(obj.meshes), None))
    return replace(room, objects=[obj for obj in objects if obj is not None]), tuple(true_changes)


def _foreign_objects(name: str, rng: Random) -> list[Placed]:
    """Objects of another room of the same kind that stand on its table or floor."""
    other_room, _ = room_of(f"{name.split('-')[0]}-{int(rng.integers(50, 99))}")
    objects = [
        obj for number, obj in enumerate(other_room.objects) if _movable(other_room, number) and _rests(obj, other_room)
    ]
    return [objects[row] for row in rng.permutation(len(objects)).tolist()]


def _box(meshes: Meshes) -> F64:
    return np.stack(extent(meshes))


def _movable(room: Room, number: int) -> bool:
    """Whether an object is no surface, not as large as furniture that others stand on, and carries nothing."""
    obj = room.objects[number]
    if obj.surface:
        return False
    low, high = extent(obj.meshes)
    for neighbor in room.objects:
        if neighbor is obj or neighbor.surface:
            continue
        below, above = extent(neighbor.meshes)
        over = (below[:2] < high[:2]).all() and (above[:2] > low[:2]).all()
        if over and below[2] > low[2] + 0.003 and below[2] < high[2] + 0.02:
            return False
    return True


def _rests(obj: Placed, room: Room) -> bool:
    """Whether it stands on the main surface, z = 0 in all rooms."""
    low, high = extent(obj.meshes)
    return bool(
        abs(low[2]) < 0.008 and not any(_over(low, high, neighbor) for neighbor in room.objects if neighbor is not obj)
    )


def _over(low: F64, high: F64, obj: Placed) -> bool:
    if obj.surface:
        return False
    below, above = extent(obj.meshes)
    return bool((below[:2] < high[:2]).all() and (above[:2] > low[:2]).all() and below[2] < low[2] + 0.01)


def _somewhere(
    obj: Placed, standing: Sequence[Placed], room: Room, rng: Random, before: Placed | None
) -> Meshes | None:
    """The object at a free place of the main surface within what photos show; where it was, not too near to that."""
    low, high = extent(
        [mesh for room_obj in room.objects if not room_obj.surface and _rests_low(room_obj) for mesh in room_obj.meshes]
    )
    bounds = extent(obj.meshes)
    size = bounds[1] - bounds[0]
    scale = 3.0 if max(high[0] - low[0], high[1] - low[1]) > 2.0 else 1.0
    middle = (bounds[0] + bounds[1]) / 2
    for _ in range(_TRIES):
        spot = rng.uniform(low[:2] + size[:2] / 2, np.maximum(high[:2] - size[:2] / 2, low[:2] + size[:2] / 2 + 1e-3))
        away = float(np.linalg.norm(spot - middle[:2]))
        if before is not None and not _NEAREST * scale < away < _FARTHEST * scale:
            continue
        centered = placed(obj.meshes, -float(middle[0]), -float(middle[1]))
        turned = placed(centered, float(spot[0]), float(spot[1]), float(rng.uniform(-np.pi, np.pi)))
        put = resting(turned, 0.001)
        box = _box(put)
        if all(_apart(box, neighbor) for neighbor in standing if not neighbor.surface):
            return put
    return None


def _rests_low(obj: Placed) -> bool:
    return bool(abs(extent(obj.meshes)[0][2]) < 0.02)


def _apart(box: F64, obj: Placed) -> bool:
    low, high = extent(obj.meshes)
    return bool((low[:2] > box[1, :2] + _GAP).any() or (high[:2] < box[0, :2] - _GAP).any())
