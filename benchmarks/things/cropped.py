"""Photos that show less of a place than they did: what only a few others show is cut off."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.types import Capture
from fastsplat_contract.camera import Camera, PosedCamera

_SHOWN = 50
"""Pixels of a label that a photo shows."""

_Box = tuple[int, int, int, int]
"""Left, top, right and bottom, pixels."""


def cropped(capture: Capture, whole: Set[str], share: float, work: Path) -> Capture:
    """The capture in which only some views show what lies to their side of it: each other one is cut to its largest
    part beside all those points, which go, too.

    Args:
        capture: with points, and label maps where it has any.
        whole: names of the views that stay.
        share: of the points, those farthest to the side where these views are, as seen from the middle of all.
        work: an existing folder for pictures.
    """
    middle = {view.posed.name: view.posed.world_from_camera[:3, 3] for view in capture.views}
    side = np.mean([middle[name] for name in whole], axis=0) - np.mean(list(middle.values()), axis=0)
    along = capture.points @ side
    is_hidden = along > np.quantile(along, 1 - share)
    hidden = capture.points[is_hidden]
    kept, labels, maps = [], capture.given_labels, []
    for number, view in enumerate(capture.views):
        path = None if labels is None else labels.map_paths[number]
        if view.posed.name not in whole:
            box = _beside(hidden, view.posed)
            view = replace(view, posed=_cut(view.posed, box), image_path=_crop(view.image_path, box, work))
            path = path and _crop(path, box, work)
        kept.append(view)
        maps.append(path)
    given = labels and replace(labels, map_paths=tuple(maps))
    points, colors = capture.points[~is_hidden], capture.point_colors[~is_hidden]
    return replace(capture, views=tuple(kept), points=points, point_colors=colors, given_labels=given)


def _beside(points: NDArray[np.floating], posed: PosedCamera) -> _Box:
    """The largest part of a view that is left of, right of, above or below all of these points."""
    width, height = posed.camera.width, posed.camera.height
    pose = posed.world_from_camera
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    local, camera = local[local[:, 2] > 0], posed.camera
    pixels = local[:, :2] / local[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    pixels = pixels[(pixels >= 0).all(axis=1) & (pixels < (width, height)).all(axis=1)]
    if not len(pixels):
        return 0, 0, width, height
    left, top = np.floor(pixels.min(axis=0)).astype(int).tolist()
    right, bottom = np.ceil(pixels.max(axis=0)).astype(int).tolist()
    boxes = [(0, 0, left, height), (right, 0, width, height), (0, 0, width, top), (0, bottom, width, height)]
    return max(boxes, key=lambda box: (box[2] - box[0]) * (box[3] - box[1]))


def _cut(posed: PosedCamera, box: _Box) -> PosedCamera:
    left, top, right, bottom = box
    camera = posed.camera
    cut = Camera(right - left, bottom - top, camera.fx, camera.fy, camera.cx - left, camera.cy - top)
    return PosedCamera(cut, posed.world_from_camera, posed.name)


def _crop(path: Path, box: _Box, work: Path) -> Path:
    target = work / f"{path.parent.name}-{path.stem}.png"
    with Image.open(path) as image:
        image.crop(box).save(target)
    return target


def hidden_labels(capture: Capture, whole: Set[str]) -> list[int]:
    """Ids of the labels that views of these names show, and no other view does."""
    given = capture.given_labels
    if given is None:
        return []
    most = np.zeros((2, len(given.dictionary) + 1), np.int64)
    for view, path in zip(capture.views, given.map_paths, strict=True):
        if path is not None:
            with Image.open(path) as label_map:
                counts = np.bincount(np.asarray(label_map).ravel(), minlength=most.shape[1])
            row = int(view.posed.name in whole)
            most[row] = np.maximum(most[row], counts)
    return [each for each in np.flatnonzero((most[1] >= _SHOWN) & (most[0] < _SHOWN)).tolist() if each]
