"""Arithmetic of label evidence: merging, and the Dirichlet posterior it leads to."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.types import F32, Evidence
from fastsplat_contract.errors import InvalidInputError

UNIT = 4096
"""Counts of one whole pixel."""

PRIOR_PIXELS = 1.0
"""α0: what is believed before any view was seen, spread evenly over all classes, in pixels of blend weight."""


@dataclass(frozen=True)
class Posterior:
    """The mean of Dirichlet(α0 + A) of each Gaussian, as far as it differs from one class to the next.

    Attributes:
        starts, labels: the rows of the evidence.
        probability: float32 [M]: (A[g, n] + α0/C) / (Σ A[g] + α0), C the number of classes.
        rest: float32 [G]: the probability of each class that the row does not name.
        classes: int32 [G]: the most probable class, ties to the lower id; 0 for a Gaussian never seen.
        confidence: float32 [G], 0..1: the probability of that class; 0 for a Gaussian never seen.
    """

    starts: NDArray[np.int64]
    labels: NDArray[np.uint16]
    probability: F32
    rest: F32
    classes: NDArray[np.int32]
    confidence: F32


def no_evidence(count: int) -> Evidence:
    """Of `count` Gaussians that no view has seen."""
    return Evidence(np.zeros(count + 1, np.int64), np.zeros(0, np.uint16), np.zeros(0, np.int64))


def evidence_of(
    rows: NDArray[np.integer], labels: NDArray[np.integer], counts: NDArray[np.int64], count: int
) -> Evidence:
    """From entries in any order; entries of one Gaussian and label are added, zeros are left out.

    Args:
        rows: int [K], Gaussian ids below `count`.
        labels: int [K], 0..65535.
        counts: int64 [K], units of 1/4096 pixel.
    """
    keys = rows.astype(np.int64) << 16 | labels.astype(np.int64)
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    first = np.flatnonzero(np.diff(keys, prepend=-1))
    sums = np.add.reduceat(counts[order], first) if len(first) else np.zeros(0, np.int64)
    keys, sums = keys[first][sums > 0], sums[sums > 0]
    starts = np.searchsorted(keys >> 16, np.arange(count + 1)).astype(np.int64)
    return Evidence(starts, (keys & 0xFFFF).astype(np.uint16), sums)


def merged(parts: Iterable[Evidence]) -> Evidence:
    """The sum of evidence of the same Gaussians: of several views, or of several groups of views.

    Raises:
        InvalidInputError: no parts, or of different numbers of Gaussians.
    """
    all_parts = list(parts)
    if not all_parts or len({len(part) for part in all_parts}) > 1:
        raise InvalidInputError(
            f"evidence of {sorted({len(part) for part in all_parts})} Gaussians cannot be combined", field="evidence"
        )
    rows = [np.repeat(np.arange(len(part)), np.diff(part.starts)) for part in all_parts]
    labels, counts = [part.labels for part in all_parts], [part.counts for part in all_parts]
    return evidence_of(np.concatenate(rows), np.concatenate(labels), np.concatenate(counts), len(all_parts[0]))


def rows_of(evidence: Evidence, rows: NDArray[np.integer]) -> Evidence:
    """The evidence of the Gaussians `rows`, in that order; a row may be named twice."""
    sizes = np.diff(evidence.starts)[rows]
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    within = np.arange(starts[-1]) - np.repeat(starts[:-1], sizes)
    entries = np.repeat(evidence.starts[:-1][rows], sizes) + within
    return Evidence(starts, evidence.labels[entries], evidence.counts[entries])


def without_rows(evidence: Evidence, gone: NDArray[np.bool_]) -> Evidence:
    """The same evidence without that of these Gaussians, bool [G]."""
    rows = np.repeat(np.arange(len(evidence)), np.diff(evidence.starts))
    stays = ~gone[rows]
    return evidence_of(rows[stays], evidence.labels[stays], evidence.counts[stays], len(evidence))


def seen_pixels(evidence: Evidence) -> F32:
    """float32 [G]: pixels of blend weight, of any class, that each Gaussian has."""
    return np.asarray(_row_sums(evidence.counts, evidence.starts) / UNIT, np.float32)


def posterior(evidence: Evidence, classes: int, *, prior: float = PRIOR_PIXELS) -> Posterior:
    """Dirichlet posterior of each Gaussian's class.

    Args:
        evidence: of G Gaussians.
        classes: C = N + 1.
        prior: α0 of all classes together, pixels; above 0.
    """
    pixels = evidence.counts / UNIT
    rows = np.repeat(np.arange(len(evidence)), np.diff(evidence.starts))
    total = _row_sums(pixels, evidence.starts) + prior
    probability = (pixels + prior / classes) / total[rows]
    winner = np.zeros(len(evidence), np.int32)
    confidence = np.zeros(len(evidence))
    # Ascending by probability, descending by label: what is written last into a row is its winner.
    order = np.lexsort((-evidence.labels.astype(np.int32), probability))
    winner[rows[order]] = evidence.labels[order]
    confidence[rows[order]] = probability[order]
    return Posterior(
        evidence.starts,
        evidence.labels,
        probability.astype(np.float32),
        (prior / classes / total).astype(np.float32),
        winner,
        confidence.astype(np.float32),
    )


def _row_sums(values: NDArray[np.generic], starts: NDArray[np.int64]) -> NDArray[np.float64]:
    ends = np.concatenate([[0], np.cumsum(values, dtype=values.dtype)])
    return np.asarray(ends[starts[1:]] - ends[starts[:-1]], np.float64)
