"""Best views of objects among a scene's cameras, by pixels in small object maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.objects.solid_gaussians import masses
from fastsplat.service.query.objects.visibility import view_scores
from fastsplat.service.query.scene_index import SceneIndex

_CANDIDATES = 5
"""Extra candidates rendered, since the first selection is only estimated."""
OBJECT_VIEW_SIDE = 256
"""Pixels of the longer side of the small object maps."""
_CUT_OFF = 0.4
"""Weight of a view that cuts the objects off, as for descriptors."""


@dataclass(frozen=True)
class ObjectView:
    """A camera that shows some objects."""

    name: str  # of the camera
    share: float  # of the picture's pixels that show them, 0..1
    cut_off: bool  # whether they reach the picture's edge
    mask: NDArray[np.bool_] = field(repr=False)  # bool [H, W], where they are, of `OBJECT_VIEW_SIDE`


def best_object_views(index: SceneIndex, object_ids: Sequence[int], count: int) -> tuple[ObjectView, ...]:
    """Returns at most `count` cameras that show the objects together, best first."""
    scene, objects = index.scene, index.objects
    rows = np.flatnonzero(objects.rows(object_ids))
    if not len(rows):
        return ()
    views, scores = view_scores(scene, [rows], masses(scene.gaussians.log_scales, scene.gaussians.logit_opacities))
    seen: list[ObjectView] = []
    for number in (-scores[0]).argsort(kind="stable")[: count + _CANDIDATES] if len(views) else ():
        check_cancelled()
        mask = objects.mask(views[number].limited_to(OBJECT_VIEW_SIDE), object_ids)
        if mask.any():
            seen.append(_view(views[number].name, mask))
    seen.sort(key=_worth, reverse=True)
    return tuple(seen[:count])


def best_view_of_each(index: SceneIndex, object_ids: Sequence[int]) -> Mapping[int, ObjectView]:
    """Best camera for each visible object, by id; draws at most five per object."""
    cameras = {posed.name: posed for posed in index.scene.cameras}
    seen_by = index.objects.best_views(object_ids)
    seen: dict[int, list[ObjectView]] = {}
    for name in sorted({name for object_id in object_ids for name in seen_by.get(object_id, ())}):
        check_cancelled()
        object_map = index.objects.map(cameras[name].limited_to(OBJECT_VIEW_SIDE))
        for target_id in object_ids:
            if name in seen_by.get(target_id, ()) and (mask := object_map == target_id).any():
                seen.setdefault(target_id, []).append(_view(name, mask))
    return {object_id: max(views, key=_worth) for object_id, views in seen.items()}


def _view(name: str, mask: NDArray[np.bool_]) -> ObjectView:
    edge = bool(mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())
    return ObjectView(name, float(mask.mean()), edge, mask)


def _worth(view: ObjectView) -> float:
    return view.share * (_CUT_OFF if view.cut_off else 1.0)
