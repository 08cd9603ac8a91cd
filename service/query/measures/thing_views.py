"""Which of a scene's cameras show some things best, by the pixels that are theirs in small maps of things."""

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
"""Cameras that are looked through beyond those that are asked for: which they are is estimated without rendering."""
_SIDE = 256
_CUT_OFF = 0.4
"""What a share counts where the things reach the picture's edge; as for what things are known by in other scenes."""


@dataclass(frozen=True)
class ThingView:
    """A camera that shows some things.

    Attributes:
        mask: bool [H, W]: where they are, in the picture reduced to 256 pixels a side.
    """

    name: str  # of the camera
    share: float  # of the picture's pixels that show them, 0..1
    cut_off: bool  # whether they reach the picture's edge
    mask: NDArray[np.bool_] = field(repr=False)


def best_thing_views(index: SceneIndex, thing_ids: Sequence[int], count: int) -> tuple[ThingView, ...]:
    """At most `count` of the scene's cameras, those that show the things best first; none that do not show them.

    Args:
        index: of the scene.
        thing_ids: of things or parts that are there, seen together.
        count: at most so many.
    """
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
    """The one of the scene's cameras that shows each of some things best, by the thing's id; nothing of things that no
    camera shows. Each camera is drawn once: at most five a thing.

    Args:
        index: of the scene.
        thing_ids: of things, not of parts, that are there.
    """
    cameras = {posed.name: posed for posed in index.scene.cameras}
    seen_by = index.things.best_views(thing_ids)
    seen: dict[int, list[ThingView]] = {}
    for name in sorted({name for each in thing_ids for name in seen_by.get(each, ())}):
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
    """The same view in a picture of at most `side` pixels a side."""
    scale = min(1.0, side / max(posed.camera.width, posed.camera.height))
    width, height = (max(1, round(side * scale)) for side in (posed.camera.width, posed.camera.height))
    return PosedCamera(posed.camera.scaled_to(width, height), posed.world_from_camera)
