"""Many numbers, or rows of them, as indices into few: the codebooks and palettes of compressed files."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.scene.types import F32

CODES = 256
"""Entries of a codebook."""

_BINS = 4096
_ROUNDS = 8
_SAMPLES_PER_ENTRY = 64
"""Rows that the coarse clusters are computed from; more make them no better."""

_DISTANCES = 1 << 22
"""That are held at once, float32."""


def codebook(values: F32) -> tuple[F32, NDArray[np.uint8]]:
    """float32 [256], ascending, and uint8 indices of the shape of `values`. No value is further than 1/256 of their
    range from its entry; entries are denser where there are more values.

    Entries are quantiles of a mixture: half the cube root of the values' density, which is what has the least squared
    error (Panter and Dite 1951), and half a uniform density, which bounds the error of each.
    """
    if not values.size:
        return np.zeros(CODES, np.float32), np.zeros(values.shape, np.uint8)
    low, high = float(values.min()), float(values.max())
    counts, edges = np.histogram(values.astype(np.float64), _BINS, (low, high) if high > low else (low - 1, low + 1))
    if high == low:
        edges[:] = low
    density = np.cbrt(counts)
    shares = np.cumsum(density / density.sum() + 1 / _BINS) / 2
    entries = np.interp((np.arange(CODES) + 0.5) / CODES, np.concatenate([[0.0], shares]), edges).astype(np.float32)
    middles = (entries[1:].astype(np.float64) + entries[:-1]) / 2
    return entries, np.searchsorted(middles, values).astype(np.uint8)


def palette(rows: F32, size: int) -> tuple[F32, NDArray[np.intp]]:
    """Entries float32 [P, C], P at most `size`, and for each of the rows [G, C] the index [G] of the one that stands
    for it. Every row is its own entry where that is few enough; otherwise entries are means of like rows, and the same
    rows have the same entries.

    Rows are clustered coarsely, then the rows of each cluster by themselves, k-means (Lloyd 1982) both times: a million
    rows and 65,536 entries cost what 512 clusters of them do.

    Raises:
        CancelledError: see `service.common.cancellation`.
    """
    if len(rows) <= size:
        return rows, np.arange(len(rows))
    rng = np.random.default_rng(0)
    coarse = max(1, math.isqrt(size))
    sample = rows[rng.choice(len(rows), min(len(rows), _SAMPLES_PER_ENTRY * coarse), replace=False)]
    cluster = _nearest(rows, _clustered(sample, coarse, rng))
    order = np.argsort(cluster, kind="stable")
    counts = np.bincount(cluster, minlength=coarse)
    ends = np.cumsum(counts)
    entries: list[F32] = []
    labels = np.empty(len(rows), np.intp)
    used = 0
    for count, end in zip(counts.tolist(), ends.tolist(), strict=True):
        members = order[end - count : end]
        if not count:
            continue
        # Rounding down the shares leaves room: at least one each, and no more than `size` together.
        share = max(1, count * (size - coarse) // len(rows))
        centers = _clustered(rows[members], share, rng)
        labels[members] = used + _nearest(rows[members], centers)
        entries.append(centers)
        used += len(centers)
    return np.concatenate(entries), labels


def _clustered(rows: F32, count: int, rng: np.random.Generator) -> F32:
    """Centers float32 [count, C] of clusters of the rows; those of empty clusters stay where they began."""
    centers = rows[rng.choice(len(rows), min(count, len(rows)), replace=False)]
    for _ in range(_ROUNDS):
        nearest = _nearest(rows, centers)
        members = csr_array(
            (np.ones(len(rows), np.float32), nearest, np.arange(len(rows) + 1)), (len(rows), len(centers))
        )
        counts = np.bincount(nearest, minlength=len(centers))[:, None]
        centers = np.where(counts > 0, members.T @ rows / np.maximum(counts, 1), centers).astype(np.float32)
    return centers


def _nearest(rows: F32, centers: F32) -> NDArray[np.intp]:
    from scipy.cluster.vq import vq  # compressed files alone need it

    nearest = np.empty(len(rows), np.intp)
    step = max(1, _DISTANCES // len(centers))
    for start in range(0, len(rows), step):
        check_cancelled()
        nearest[start : start + step] = vq(rows[start : start + step], centers, check_finite=False)[0]
    return nearest
