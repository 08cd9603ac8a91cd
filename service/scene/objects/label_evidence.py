"""Merges label evidence and computes its Dirichlet posterior."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.artefact.scene import F32, Evidence
from fastsplat_contract.errors import InvalidInputError

UNIT = 4096
"""Counts per pixel."""

PRIOR_PIXELS = 1.0
"""α0: prior weight of all classes together, in pixels of blend weight."""


@dataclass(frozen=True)
class Posterior:
    """Mean of Dirichlet(α0 + A) of each Gaussian over C classes, stored sparsely."""

    starts: NDArray[np.int64]  # as in the evidence
    labels: NDArray[np.uint16]  # as in the evidence
    probability: F32  # [M]: (A[g, n] + α0/C) / (Σ A[g] + α0)
    rest: F32  # [G]: probability of each class that the row does not list
    classes: NDArray[np.int32]  # [G]: most probable class, ties to the lower id; 0 for a Gaussian never seen
    confidence: F32  # [G]: its probability; 0 for a Gaussian never seen


def no_evidence(count: int) -> Evidence:
    return Evidence(np.zeros(count + 1, np.int64), np.zeros(0, np.uint16), np.zeros(0, np.int64))


def evidence_of(
    rows: NDArray[np.integer], labels: NDArray[np.integer], counts: NDArray[np.int64], count: int
) -> Evidence:
    """Builds evidence from unordered entries [K]; sums duplicates and drops zeros."""
    keys = rows.astype(np.int64) << 16 | labels.astype(np.int64)
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    first = np.flatnonzero(np.diff(keys, prepend=-1))
    sums = np.add.reduceat(counts[order], first) if len(first) else np.zeros(0, np.int64)
    keys, sums = keys[first][sums > 0], sums[sums > 0]
    starts = np.searchsorted(keys >> 16, np.arange(count + 1)).astype(np.int64)
    return Evidence(starts, (keys & 0xFFFF).astype(np.uint16), sums)


def merged(parts: Iterable[Evidence]) -> Evidence:
    """Adds evidence of the same Gaussians from several views.

    Raises:
        InvalidInputError: no parts, or different numbers of Gaussians.
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
    """Selects the evidence of the Gaussians `rows`, in that order; repetitions are allowed."""
    sizes = np.diff(evidence.starts)[rows]
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    within = np.arange(starts[-1]) - np.repeat(starts[:-1], sizes)
    entries = np.repeat(evidence.starts[:-1][rows], sizes) + within
    return Evidence(starts, evidence.labels[entries], evidence.counts[entries])


def with_unseen(evidence: Evidence, count: int) -> Evidence:
    """Appends `count` Gaussians that no view has seen."""
    return Evidence(np.append(evidence.starts, np.full(count, evidence.starts[-1])), evidence.labels, evidence.counts)


def without_rows(evidence: Evidence, gone: NDArray[np.bool_]) -> Evidence:
    """Clears the evidence of the Gaussians in the mask `gone` [G]."""
    rows = np.repeat(np.arange(len(evidence)), np.diff(evidence.starts))
    stays = ~gone[rows]
    return evidence_of(rows[stays], evidence.labels[stays], evidence.counts[stays], len(evidence))


def seen_pixels(evidence: Evidence) -> F32:
    """Returns each Gaussian's pixels of blend weight over all classes, float32 [G]."""
    return np.asarray(_row_sums(evidence.counts, evidence.starts) / UNIT, np.float32)


def posterior(evidence: Evidence, classes: int, *, prior: float = PRIOR_PIXELS) -> Posterior:
    """Computes the Dirichlet posterior over C = N + 1 classes, `prior` in pixels."""
    pixels = evidence.counts / UNIT
    rows = np.repeat(np.arange(len(evidence)), np.diff(evidence.starts))
    total = _row_sums(pixels, evidence.starts) + prior
    probability = (pixels + prior / classes) / total[rows]
    winner = np.zeros(len(evidence), np.int32)
    confidence = np.zeros(len(evidence))
    # Ascending by probability, descending by label: the last write into a row wins.
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
