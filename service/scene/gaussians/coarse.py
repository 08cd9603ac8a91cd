"""Reduces large scenes to fewer Gaussians for previews and surface queries."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.artefact.scene import F32, Gaussians, SceneT
from fastsplat.service.scene.gaussians.scene_rows import scene_of_rows

COARSE_GAUSSIANS = 60_000
"""Approximate number of Gaussians in a coarse scene."""

_WORTH = 1.5  # scenes with more than this multiple of the target are reduced
_SOLID = 0.99  # upper bound of raised opacities
_ROUNDS = 60
_SEED = 0


def coarse_scene(scene: SceneT, most: int = COARSE_GAUSSIANS) -> SceneT | None:
    """Samples about `most` Gaussians that stand for the rest, with constant color.

    A Gaussian's weight is its opacity times the geometric mean of its two longer axes. The heaviest are kept unchanged;
    others are kept with probability proportional to weight and made more opaque, then larger, to make up for those
    dropped. Deterministic. The page's `draft.ts` does the same. Returns None if the scene is small already.
    """
    gaussians = scene.gaussians
    if len(gaussians) <= _WORTH * most:
        return None
    opacities = 1 / (1 + np.exp(-gaussians.logit_opacities.astype(np.float64)))
    log_scales = np.sort(gaussians.log_scales, axis=1).astype(np.float64)
    covers = opacities * np.exp(log_scales[:, 1:].sum(axis=1) / 2)
    shares = np.minimum(1, _rate(covers, most) * covers)
    # Systematic sampling: each run of rows, which are near in space, keeps as many as its shares sum to.
    offset = np.random.default_rng(_SEED).random()
    rows = np.flatnonzero(np.diff(np.floor(np.cumsum(shares) + offset), prepend=0.0) > 0)
    subset = scene_of_rows(scene, rows)
    return replace(subset, gaussians=_standing(subset.gaussians, opacities[rows], 1 / shares[rows]))


def _rate(covers: NDArray[np.float64], most: int) -> float:
    """Returns the factor at which min(1, factor · covers) sums to `most`."""
    low, high = 0.0, most / max(1e-30, float(covers[covers > 0].min(initial=np.inf)))
    for _ in range(_ROUNDS):
        middle = (low + high) / 2
        if np.minimum(1, middle * covers).sum() < most:
            low = middle
        else:
            high = middle
    return high


def _standing(gaussians: Gaussians, opacities: NDArray[np.float64], stands: NDArray[np.float64]) -> Gaussians:
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
