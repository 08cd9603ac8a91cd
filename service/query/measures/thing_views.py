"""Best views of things among a scene's cameras, by pixels in small thing maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.things.solid_gaussians import masses
from fastsplat.service.query.things.visibility import view_scores
from fastsplat_contract.geometry.camera import PosedCamera

_CANDIDATES = 5
"""Extra candidates rendered, since the first selection is only estimated."""
_SIDE = 256
_CUT_OFF = 0.4
"""Weight of a view that cuts the things off, as for descriptors."""


@dataclass(frozen=True)
class ThingView:
    """A camera that shows some things."""

    name: str  # of the camera
    share: float  # of the picture's pixels that show them, 0..1
    cut_off: bool  # whether they reach the picture's edge
    mask: NDArray[np.bool_] = field(repr=False)  # bool [H, W], where they are, at most 256 pixels a side


def best_thing_views(index: SceneIndex, thing_ids: Sequence[int], count: int) -> tuple[ThingView, ...]:
    """Returns at most `count` cameras that show the things together, best first."""
    scene, things = index.scene, index.things
    rows = np.flatnonzero(things.rows(thing_ids))
    if not len(rows):
        return ()
    views, scores = view_scores(scene, [rows], masses(scene.gaussians.log_scales, scene.gaussians.logit_opacities))
    seen: list[ThingView] = []
    for number in (-scores[0]).argsort(kind="stable")[: count + _CANDIDATES] if len(views) else ():
        check_cancelled()
        mask = things.mask(small_view(views[number]), thing_ids)
        if mask.any():
            seen.append(_view(views[number].name, mask))
    seen.sort(key=_worth, reverse=True)
    return tuple(seen[:count])


def best_view_of_each(index: SceneIndex, thing_ids: Sequence[int]) -> Mapping[int, ThingView]:
    """Best camera for each visible thing, by id; draws at most five per thing."""
    cameras = {posed.name: posed for posed in index.scene.cameras}
    seen_by = index.things.best_views(thing_ids)
    seen: dict[int, list[ThingView]] = {}
    for name in sorted({name for thing_id in thing_ids for name in seen_by.get(thing_id, ())}):
        check_cancelled()
        shown = index.things.map(small_view(cameras[name]))
        for each in thing_ids:
            if name in seen_by.get(each, ()) and (mask := shown == each).any():
                seen.setdefault(each, []).append(_view(name, mask))
    return {each: max(views, key=_worth) for each, views in seen.items()}


def _view(name: str, mask: NDArray[np.bool_]) -> ThingView:
    edge = bool(mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())
    return ThingView(name, float(mask.mean()), edge, mask)


def _worth(view: ThingView) -> float:
    return view.share * (_CUT_OFF if view.cut_off else 1.0)


def small_view(posed: PosedCamera, side: int = _SIDE) -> PosedCamera:
    """Scales a view to at most `side` pixels a side."""
    scale = min(1.0, side / max(posed.camera.width, posed.camera.height))
    width, height = (max(1, round(side * scale)) for side in (posed.camera.width, posed.camera.height))
    return PosedCamera(posed.camera.scaled_to(width, height), posed.world_from_camera)
