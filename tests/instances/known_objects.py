"""Made scenes: Gaussians of known objects, and what views propose of them."""

from __future__ import annotations

import numpy as np

from fastsplat.service.instances.discovery.candidates import Candidate
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.splatting.labels.region_groups import LiftedRegions


def gaussians_at(points: np.ndarray, scale: float = 0.02) -> Gaussians:
    """Round, nearly opaque Gaussians at [G, 3]."""
    count = len(points)
    return Gaussians(
        means=points.astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.full((count, 3), np.log(scale), np.float32),
        logit_opacities=np.full(count, 4.0, np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
        codes=np.zeros((count, 0), np.float32),
    )


def candidate(
    rows: np.ndarray | range, *, support: float = 1.0, proposed: int = 4, missed: int = 0, share: float = 1.0
) -> Candidate:
    """Of Gaussians that fill one pixel each."""
    array = np.array(rows, np.int32)
    shares = np.full(len(array), share, np.float32)
    views = tuple(range(proposed + missed))
    return Candidate(array, shares, float(len(array)), support, views[:proposed], views[proposed:])


def lifted(gaussians: int, regions: list[np.ndarray | range], visible: np.ndarray | None = None) -> LiftedRegions:
    """A view in which every visible Gaussian fills one pixel."""
    sees = np.ones(gaussians, np.bool_) if visible is None else visible
    rows = [np.array([row for row in region if sees[row]], np.int32) for region in regions]
    starts = np.concatenate([[0], np.cumsum([len(region) for region in rows])]).astype(np.int64)
    return LiftedRegions(starts, np.concatenate([*rows, np.zeros(0, np.int32)]), sees.astype(np.float32))


def grid(
    width: float, depth: float, step: float, height: float = 0.0, center: tuple[float, float] = (0.0, 0.0)
) -> np.ndarray:
    """Points of a level rectangle about a center, [K, 3]."""
    x, y = np.arange(-width / 2, width / 2, step), np.arange(-depth / 2, depth / 2, step)
    flat = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    flat += center
    return np.concatenate([flat, np.full((len(flat), 1), height)], axis=1)
