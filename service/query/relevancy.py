"""Scores of dictionary entries against queries: pure arithmetic on embeddings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class Scores:
    """Q queries against N entries.

    Attributes:
        similarity: float64 [Q, N], cosines d·q.
        margin: float64 [Q, N], d·q − max_j d·c_j.
        relevancy: float64 [Q, N], σ(t·margin), 0..1.
        nearest_negative: int [N], the j of that maximum: the negative that set the relevancy.
    """

    similarity: NDArray[np.float64]
    margin: NDArray[np.float64]
    relevancy: NDArray[np.float64]
    nearest_negative: NDArray[np.intp]


def score(labels: F32, queries: F32, negatives: F32, temperature: float) -> Scores:
    """LERF's relevancy (Kerr et al. 2023, section 3.3), held against dictionary entries as in FAST-Splat, section 4.

    r = min_j softmax(t·[d·q, d·c_j])_0 = σ(t (d·q − max_j d·c_j)). The term max_j d·c_j belongs to the entry, so that
    relevancy is monotone in similarity for one entry and many queries, and not for one query and many entries.

    Args:
        labels: [N, E], queries: [Q, E], negatives: [J, E], J ≥ 1; all of unit length.
        temperature: t ≥ 0.
    """
    if not len(labels):
        nothing = np.zeros((len(queries), 0))
        return Scores(nothing, nothing, nothing, np.zeros(0, dtype=np.intp))
    similarity = np.clip((queries @ labels.T).astype(np.float64), -1.0, 1.0)
    against = np.clip((labels @ negatives.T).astype(np.float64), -1.0, 1.0)
    nearest = against.argmax(axis=1)
    margin = similarity - against.max(axis=1)
    relevancy = 0.5 * (1.0 + np.tanh(0.5 * temperature * margin))  # the sigmoid that cannot overflow
    return Scores(similarity, margin, relevancy, nearest)
