"""Next-best views: at hidden space, gaps in the ring of cameras, and sparsely seen surfaces."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.language.sentences.enclosures import may_hold
from fastsplat.service.query.objects.solid_gaussians import solid_rows
from fastsplat.service.query.objects.unseen_space import hiding_points
from fastsplat.service.query.objects.visibility import SightLines, shows
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.assessment import common_point
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import look_at
from fastsplat_contract.photos.next_photos import NextPhoto, NextPhotoReason

F64 = NDArray[np.float64]
Rows = NDArray[np.intp]

MOST = 3
_GAP_DEG = 60.0
"""Photos further apart than this share too little to be registered to each other."""
_STEP_DEG = 25.0
"""Step between photos: two thirds of the content overlaps."""
_THIN_DEG = 15.0
_FEW_VIEWS = 2
_SAMPLES = 4_000
_CELLS = 8
_LEAST_SHARE = 0.02
"""Least share of the samples in a cell that is worth a photo."""
_APART = 0.25
_CLEAR = 0.12
_INSIDE = 12
_STEP_BACK = 0.15
_TURNS_DEG = (30.0, -30.0, 60.0, -60.0, 90.0, -90.0, 135.0, -135.0, 180.0)
"""Rotations tried around what is hidden until it is in sight."""
_AROUND = 0.01 * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
"""Points around a target that must be in sight, relative to the scene's size."""
_NEARER = (1.0, 0.7, 0.45)
"""Distance factors tried if walls are in the way."""


def next_photos(index: SceneIndex) -> tuple[NextPhoto, ...]:
    """Suggests at most three viewpoints, most useful first; none without cameras.

    First come hidden places where objects may be that a question answers with `not_seen`: the camera goes around the
    occluder until they are in sight; closed objects are to be opened. Then gaps of 60° or more between cameras, seen
    from their common point about the vertical: viewpoints lie a step of 25° beside the edges, to overlap the next
    photo. Last, surfaces seen by at most two cameras or from within 15° only, ignoring occlusion. Viewpoints inside
    walls or objects are dropped."""
    cameras = index.scene.cameras
    if not cameras:
        return ()
    solid = solid_rows(index.scene.gaussians)
    if not len(solid):
        return ()
    focus = common_point(cameras)
    points = index.scene.gaussians.means[solid].astype(np.float64)
    candidates = [
        *_at_hidden(index, solid),
        *([] if focus is None else _beside_gaps(index, focus)),
        *_at_thin_surfaces(index, solid),
    ]
    chosen: list[tuple[NextPhoto, F64]] = []
    for pose, target, near, reason, says in candidates:
        place, reach = pose[:3, 3], float(np.linalg.norm(target - pose[:3, 3]))
        if _crowded(points, place, target) or any(np.linalg.norm(place - spot) < _APART * reach for _, spot in chosen):
            continue
        posed = replace(near, world_from_camera=pose, name="")
        advice = _sentence(near, place, target, says or f"look at {_called(_name_at(index, solid, points, target))}")
        chosen.append((NextPhoto(posed, near.name, reason, advice), place))
        if len(chosen) == MOST:
            break
    return tuple(photo for photo, _ in chosen)


Candidate = tuple[F64, F64, PosedCamera, NextPhotoReason, str]
"""world_from_camera, target, nearest camera, reason and advice ("": look at the target)."""


def _at_hidden(index: SceneIndex, solid: Rows) -> Iterator[Candidate]:
    """Viewpoints for hidden space, and at the nearest photo of the largest closed object."""
    unseen, up, cameras = index.objects.unseen, _up(index.scene), index.scene.cameras
    called, taken_for = index.objects.names.called, index.objects.names.taken_for
    if unseen.hides and unseen.middle is not None:
        target = np.array(unseen.middle)
        near = min(cameras, key=lambda posed: float(np.linalg.norm(posed.world_from_camera[:3, 3] - target)))
        behind = next((called[object_id] for object_id in unseen.behind if called.get(object_id)), "")
        opaque, _ = hiding_points(index.scene, solid, index.objects.owner[solid])
        around = target + _AROUND * float(np.ptp(opaque, axis=0).max())
        for turn, nearer in product(_TURNS_DEG, _NEARER):
            turned = Rotation.from_rotvec(np.radians(turn) * up).apply(near.world_from_camera[:3, 3] - target) * nearer
            pose = look_at(target + turned, target, up)
            sight = SightLines(replace(near, world_from_camera=pose), opaque)
            cell, depth, _ = sight.cells(around)
            in_sight = (depth <= sight.nearest[cell]).sum() == len(around)
            if in_sight and not _crowded(opaque, pose[:3, 3], target):
                yield pose, target, near, "hidden", f"look behind {_called(behind)}"
                break
    for hollow in may_hold(unseen, "", taken_for)[:1]:
        near = next((posed for posed in cameras if posed.name == hollow.view), cameras[0])
        target = np.array(hollow.middle)
        obj = called.get(hollow.object_id, "") or "object that has no name there"
        yield (look_at(near.world_from_camera[:3, 3], target, up), target, near, "hidden", f"look into the {obj}, open")


def _beside_gaps(index: SceneIndex, focus: F64) -> Iterator[Candidate]:
    """Viewpoints beside each gap in the ring of cameras, largest gap first."""
    cameras = index.scene.cameras
    up = _up(index.scene)
    offsets = np.stack([posed.world_from_camera[:3, 3] for posed in cameras]) - focus
    first = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    first /= np.linalg.norm(first)
    angles = np.degrees(np.arctan2(offsets @ np.cross(up, first), offsets @ first)) % 360
    order = np.argsort(angles, kind="stable")
    ring = [*order, order[0]]
    gaps = []
    for start, end in pairwise(ring):
        width = (angles[end] - angles[start]) % 360 if start != end else 360.0
        gaps.append((float(width), int(start), int(end)))
    for width, start, end in sorted(gaps, key=lambda gap: -gap[0]):
        if width < _GAP_DEG:
            return
        step = min(_STEP_DEG, width / 2)
        edges = ((start, step), (end, -step)) if width > 2 * _STEP_DEG else ((start, step),)
        for edge, turn in edges:
            place = focus + Rotation.from_rotvec(np.radians(turn) * up).apply(offsets[edge])
            yield look_at(place, focus, up), focus, cameras[edge], "gap", ""


def _at_thin_surfaces(index: SceneIndex, solid: Rows) -> Iterator[Candidate]:
    """Viewpoints at another angle to surfaces seen from few directions, largest patch first."""
    cameras, up = index.scene.cameras, _up(index.scene)
    rows = solid[:: max(1, len(solid) // _SAMPLES)]
    points = index.scene.gaussians.means[rows].astype(np.float64)
    seen = np.zeros(len(points), np.int64)
    total = np.zeros((len(points), 3))
    for posed in cameras:
        check_cancelled()
        rows, _, _ = posed.in_picture(points)
        towards = posed.world_from_camera[:3, 3] - points[rows]
        seen[rows] += 1
        total[rows] += towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
    mean = np.linalg.norm(total, axis=1) / np.maximum(seen, 1)
    # The mean of directions evenly within an angle of ±a has the length sin(a) / a on a circle: 0.989 for 15°.
    narrow = mean > np.sin(np.radians(_THIN_DEG)) / np.radians(_THIN_DEG)
    thin = (seen > 0) & ((seen <= _FEW_VIEWS) | narrow)
    low, size = points.min(axis=0), float(np.ptp(points, axis=0).max())
    cells = np.floor((points - low) / max(size, 1e-12) * _CELLS).astype(np.int64) @ np.array([10_000, 100, 1])
    for cell, count in Counter(cells[thin].tolist()).most_common(MOST * 3):
        if count < _LEAST_SHARE * len(points):
            return
        patch = thin & (cells == cell)
        target = points[patch].mean(axis=0)
        views = [posed for posed in cameras if shows(posed, target)]
        if not views:
            continue
        near = min(views, key=lambda posed: float(np.linalg.norm(posed.world_from_camera[:3, 3] - target)))
        positions = np.stack([posed.world_from_camera[:3, 3] for posed in cameras])
        places = [
            target + Rotation.from_rotvec(np.radians(turn) * up).apply(near.world_from_camera[:3, 3] - target)
            for turn in (_STEP_DEG, -_STEP_DEG)
        ]
        place = max(places, key=lambda spot: float(np.linalg.norm(positions - spot, axis=1).min()))
        yield look_at(place, target, up), target, near, "few_directions", ""


def _crowded(points: F64, place: F64, target: F64) -> bool:
    """True if a viewpoint is inside something, relative to its distance from the target."""
    clear = _CLEAR * float(np.linalg.norm(target - place))
    return bool((np.linalg.norm(points - place, axis=1) < clear).sum() >= _INSIDE)


def _up(scene: Scene) -> F64:
    """Unit up vector of the scene, else the mean up of its pictures."""
    vertical = scene.vertical()
    if vertical is not None:
        return np.array(vertical.up, dtype=np.float64)
    up = -np.mean([posed.world_from_camera[:3, 1] for posed in scene.cameras], axis=0)
    return np.asarray(up / max(float(np.linalg.norm(up)), 1e-12), dtype=np.float64)


def _name_at(index: SceneIndex, solid: Rows, points: F64, target: F64) -> str:
    """Most frequent name among the Gaussians around a point; "" for none."""
    near = solid[np.argsort(np.linalg.norm(points - target, axis=1))[:200]]
    names = {obj.id: obj.name for obj in index.objects.table.table if obj.name}
    counts = Counter(names[owner] for owner in index.objects.owner[near].tolist() if owner in names)
    return counts.most_common(1)[0][0] if counts else ""


def _called(name: str) -> str:
    return f"the {name}" if name else "the middle of the place"


def _sentence(near: PosedCamera, place: F64, target: F64, doing: str) -> str:
    """Describes a viewpoint relative to the nearest camera, and what to do there."""
    pose = near.world_from_camera
    offset = (place - pose[:3, 3]) @ pose[:3, :3]
    reach, now = float(np.linalg.norm(target - place)), float(np.linalg.norm(target - pose[:3, 3]))
    side = "right" if offset[0] > 0 else "left"
    words = [f"Stand {side} of {near.name}" if offset.any() else f"Stand where {near.name} was taken"]
    if reach > (1 + _STEP_BACK) * now:
        words.append("a step further back")
    elif reach < (1 - _STEP_BACK) * now:
        words.append("a step closer")
    return ", ".join(words) + f", and {doing}."
