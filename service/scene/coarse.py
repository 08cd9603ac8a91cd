"""A large scene in fewer Gaussians, for a camera that moves and for what needs to know only where surfaces are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.scene_rows import scene_of_rows
from fastsplat.service.scene.types import F32, Gaussians, Scene

COARSE_GAUSSIANS = 60_000
"""About so many Gaussians a coarse scene has."""

_WORTH = 1.5  # times as many, from which a scene is large
_SOLID = 0.99  # the largest opacity that a Gaussian gets by standing for others
_ROUNDS = 60
_SEED = 0


def coarse_scene(scene: Scene, most: int = COARSE_GAUSSIANS) -> Scene | None:
    """A scene in fewer Gaussians, each standing for those that were left out, of one color from all sides.

    The more a Gaussian covers (opacity by the geometric mean of its two longer axes), the surer it stays; those that
    cover most stay as they are. Another one stays with a probability in proportion, and covers for the rest of its
    kind: more opaque, and where that does not do, larger. The page's `draft.ts` does the same of what it has loaded.
    The same scene gives the same Gaussians.

    Returns:
        None for a scene that is small anyway.
    """
    gaussians = scene.gaussians
    if len(gaussians) <= _WORTH * most:
        return None
    opacities = 1 / (1 + np.exp(-gaussians.logit_opacities.astype(np.float64)))
    log_scales = np.sort(gaussians.log_scales, axis=1).astype(np.float64)
    covers = opacities * np.exp(log_scales[:, 1:].sum(axis=1) / 2)
    shares = np.minimum(1, _rate(covers, most) * covers)
    # Systematic sampling: of rows that follow each other, which are near in space, as many stay as their shares sum to.
    offset = np.random.default_rng(_SEED).random()
    rows = np.flatnonzero(np.diff(np.floor(np.cumsum(shares) + offset), prepend=0.0) > 0)
    kept = scene_of_rows(scene, rows)
    return replace(kept, gaussians=_standing(kept.gaussians, opacities[rows], 1 / shares[rows]))


def _rate(covers: NDArray[np.float64], most: int) -> float:
    """By which covers are multiplied to be shares, at most 1 each, that sum up to `most`."""
    low, high = 0.0, most / max(1e-30, float(covers[covers > 0].min(initial=np.inf)))
    for _ in range(_ROUNDS):
        middle = (low + high) / 2
        if np.minimum(1, middle * covers).sum() < most:
            low = middle
        else:
            high = middle
    return high


def _standing(gaussians: Gaussians, opacities: NDArray[np.float64], stands: NDArray[np.float64]) -> Gaussians:
    """The Gaussians, each for `stands` [K] of its kind."""
    denser = np.maximum(opacities, np.minimum(_SOLID, 1 - (1 - opacities) ** stands))
    wider = np.maximum(0, 0.5 * np.log(stands * opacities / denser))
    more = stands > 1
    logits: F32 = np.where(more, np.log(denser / (1 - denser)), gaussians.logit_opacities).astype(np.float32)
    return replace(
        gaussians,
        logit_opacities=logits,
        log_scales=(gaussians.log_scales + (wider * more)[:, None]).astype(np.float32),
        sh=gaussians.sh[:, :1].copy(),
    )
