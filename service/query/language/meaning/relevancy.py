"""Scores of dictionary entries against queries: pure arithmetic on embeddings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.logistic import logistic

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

LERF_TEMPERATURE = 10.0
"""Kerr et al. 2023, section 3.3."""


@dataclass(frozen=True)
class Entries:
    """A dictionary prepared for comparison."""

    labels: F32  # float32 [N, E], unit length
    negative_similarity: F64  # float64 [N], max_j d·c_j: the cosine with the nearest canonical negative
    nearest_negative: NDArray[np.intp]  # int [N], that j


@dataclass(frozen=True)
class Scores:
    """Q queries against N entries, float64 [Q, N] each."""

    similarity: F64  # cosines d·q
    margin: F64  # d·q − max_j d·c_j
    relevancy: F64  # σ(t·margin), 0..1


def entries(labels: F32, negatives: F32) -> Entries:
    """Prepares labels [N, E] and negatives [J, E], J ≥ 1, all of unit length."""
    if not len(labels):
        return Entries(np.zeros((0, negatives.shape[1]), dtype=np.float32), np.zeros(0), np.zeros(0, dtype=np.intp))
    similarity = cosines(labels, negatives)
    return Entries(labels, similarity.max(axis=1), similarity.argmax(axis=1))


def relevancy_scores(similarity: F64, dictionary: Entries, temperature: float) -> Scores:
    """LERF's relevancy (Kerr et al. 2023, section 3.3) as in FAST-Splat, section 4.

    r = min_j softmax(t·[d·q, d·c_j])_0 = σ(t (d·q − max_j d·c_j)). max_j d·c_j depends on the entry, so relevancy is
    monotone in similarity for one entry and many queries, but not for one query and many entries.

    Args:
        similarity: float64 [Q, N], cosines d·q of queries and entries.
        dictionary: N entries.
        temperature: t ≥ 0.
    """
    margin = similarity - dictionary.negative_similarity
    relevancy = logistic(temperature * margin)
    return Scores(similarity, margin, relevancy)


def cosines(left: F32, right: F32) -> F64:
    """Cosines of unit vectors [A, E] and [B, E], float64 [A, B]."""
    # einsum stays on this thread: waking BLAS threads costs more than so small a product.
    return np.asarray(np.clip(np.einsum("ae,be->ab", left, right), -1.0, 1.0), dtype=np.float64)
