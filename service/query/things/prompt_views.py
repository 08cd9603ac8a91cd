"""The views in which a thing that was segmented in one view is segmented again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.things.solid_gaussians import masses
from fastsplat.service.query.things.visibility import view_scores
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.geometry.camera import PosedCamera

_NEAR = 0.35
"""Radians: views that see a thing from nearly the same side say little that is new."""
_FAR, _OPPOSITE = 1.2, 2.2
"""Radians: from there on a view shows less of what was segmented, and from here on hardly any."""
_LEAST = 0.05


def further_views(scene: Scene, rows: NDArray[np.int64], first: PosedCamera, count: int) -> tuple[PosedCamera, ...]:
    """At most `count` of the scene's cameras that see Gaussians well, from other sides than `first` and each other,
    best first.

    Args:
        scene: with its cameras.
        rows: int64 [K], ids of the Gaussians, at least one.
        first: where they were seen already.
        count: of views.
    """
    gaussians = scene.gaussians
    views, scores = view_scores(scene, [rows], masses(gaussians.log_scales, gaussians.logit_opacities))
    if not views:
        return ()
    middle = np.median(gaussians.means[rows].astype(np.float64), axis=0)
    sides = np.stack([_side(posed, middle) for posed in views])
    seen = scores[0]
    # Large enough is large enough: between those the side decides.
    seen = np.minimum(seen, np.median(seen[seen > 0])) if (seen > 0).any() else seen
    used, result = [_side(first, middle)], []
    for _ in range(count):
        angle = np.arccos(np.clip(sides @ np.stack(used).T, -1, 1)).min(axis=1)
        fits = np.clip((_OPPOSITE - angle) / (_OPPOSITE - _FAR), _LEAST, 1)
        value = seen * np.clip(angle / _NEAR, 0, 1) * fits
        best = int(value.argmax())
        if value[best] <= 0:
            break
        result.append(views[best])
        used.append(sides[best])
    return tuple(result)


def _side(posed: PosedCamera, point: NDArray[np.float64]) -> NDArray[np.float64]:
    direction = posed.world_from_camera[:3, 3] - point
    return np.asarray(direction / max(float(np.linalg.norm(direction)), 1e-12))
