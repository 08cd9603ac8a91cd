"""Further views for segmenting an object that was prompted in one view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.objects.solid_gaussians import masses
from fastsplat.service.query.objects.visibility import view_scores
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.geometry.camera import PosedCamera

_NEAR = 0.35
"""Radians within which a view adds little."""
_FAR, _OPPOSITE = 1.2, 2.2
"""Radians from which the segmented side fades, and is hardly visible."""
_LEAST = 0.05


def further_views(scene: Scene, rows: NDArray[np.int64], first: PosedCamera, count: int) -> tuple[PosedCamera, ...]:
    """Selects at most `count` cameras that see Gaussians `rows` [K] from new sides, best first."""
    gaussians = scene.gaussians
    views, scores = view_scores(scene, [rows], masses(gaussians.log_scales, gaussians.logit_opacities))
    if not views:
        return ()
    middle = np.median(gaussians.means[rows].astype(np.float64), axis=0)
    sides = np.stack([_side(posed, middle) for posed in views])
    seen = scores[0]
    # Scores above the median count the same: among large views the direction decides.
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
