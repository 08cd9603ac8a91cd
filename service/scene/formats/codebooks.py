"""Vector quantization for compressed files: codebooks of scalars, palettes of rows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.scene.artefact.scene import F32

CODES = 256
"""Entries of a codebook."""

_BINS = 4096
_ROUNDS = 8
_SAMPLES_PER_ENTRY = 64  # rows per coarse cluster; more do not improve them

_DISTANCES = 1 << 22  # held in memory at once, float32


def codebook(values: F32) -> tuple[F32, NDArray[np.uint8]]:
    """Quantizes values to 256 ascending entries, float32, and uint8 indices.

    Entries are quantiles of a mixture: half the cube root of the density, which minimizes squared error (Panter and
    Dite 1951), half uniform, which keeps every value within 1/256 of the range from its entry.
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
    """Quantizes rows [G, C] to at most `size` entries, float32 [P, C], and indices [G].

    Two-level k-means (Lloyd 1982): coarse clusters, then each on its own, so a million rows and 65,536 entries cost no
    more than 512 clusters of them. Deterministic. Few rows are their own entries.

    Raises:
        CancelledError: the call was cancelled.
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
        # Shares are rounded down, so that at least one each stays within `size` in total.
        share = max(1, count * (size - coarse) // len(rows))
        centers = _clustered(rows[members], share, rng)
        labels[members] = used + _nearest(rows[members], centers)
        entries.append(centers)
        used += len(centers)
    return np.concatenate(entries), labels


def _clustered(rows: F32, count: int, rng: np.random.Generator) -> F32:
    """K-means centers, float32 [count, C]; empty clusters keep their initial centers."""
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
