"""Scores of dictionary entries against queries: pure arithmetic on embeddings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

LERF_TEMPERATURE = 10.0
"""Kerr et al. 2023, section 3.3."""


@dataclass(frozen=True)
class Entries:
    """A dictionary ready to be asked.

    Attributes:
        labels: float32 [N, E], unit length.
        against: float64 [N], max_j d·c_j: the likeness to the canonical negative that is nearest.
        nearest_negative: int [N], that j.
    """

    labels: F32
    against: NDArray[np.float64]
    nearest_negative: NDArray[np.intp]


@dataclass(frozen=True)
class Scores:
    """Q queries against N entries, float64 [Q, N] each.

    Attributes:
        similarity: cosines d·q.
        margin: d·q − max_j d·c_j.
        relevancy: σ(t·margin), 0..1.
    """

    similarity: NDArray[np.float64]
    margin: NDArray[np.float64]
    relevancy: NDArray[np.float64]


def entries(labels: F32, negatives: F32) -> Entries:
    """What does not depend on the query, of labels [N, E] and negatives [J, E], J ≥ 1, all of unit length."""
    if not len(labels):
        return Entries(np.zeros((0, negatives.shape[1]), dtype=np.float32), np.zeros(0), np.zeros(0, dtype=np.intp))
    cosines = _cosines(labels, negatives)
    return Entries(labels, cosines.max(axis=1), cosines.argmax(axis=1))


def score(asked: Entries, queries: F32, temperature: float) -> Scores:
    """LERF's relevancy (Kerr et al. 2023, section 3.3), held against dictionary entries as in FAST-Splat, section 4.

    r = min_j softmax(t·[d·q, d·c_j])_0 = σ(t (d·q − max_j d·c_j)). The term max_j d·c_j belongs to the entry, so that
    relevancy is monotone in similarity for one entry and many queries, and not for one query and many entries.

    Args:
        asked: N entries.
        queries: [Q, E], unit length.
        temperature: t ≥ 0.
    """
    similarity = _cosines(queries, asked.labels)
    margin = similarity - asked.against
    relevancy = 0.5 * (1.0 + np.tanh(0.5 * temperature * margin))  # the sigmoid that cannot overflow
    return Scores(similarity, margin, relevancy)


def _cosines(left: F32, right: F32) -> NDArray[np.float64]:
    """float64 [A, B]. einsum stays on this thread: waking BLAS threads costs more than so small a product."""
    return np.asarray(np.clip(np.einsum("ae,be->ab", left, right), -1.0, 1.0), dtype=np.float64)
