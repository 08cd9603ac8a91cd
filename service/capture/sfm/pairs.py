"""Chooses the image pairs to match."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Pair = tuple[int, int]

_PROBES = 256
"""Features for the all-pairs comparison; 512 took four times as long for 0.4 % more matches."""
_MAX_RATIO = 0.8
_SPREAD_IMAGES = 6
_NEIGHBORS = {False: (1, 2), True: (1, 2, 3, 4, 5, 6, 8, 12, 16)}


def probes(descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Normalizes SIFT descriptors of an image's largest features, its first, which match most likely, [K, 128]."""
    vectors = descriptors[:_PROBES].astype(np.float32)
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9))


def probe_scores(images: Sequence[NDArray[np.float32]]) -> NDArray[np.int32]:
    """Counts mutual ratio-tested matches of images' probes, [N, N] (Wu, 3DV 2013, section 3)."""
    scores = np.zeros((len(images), len(images)), np.int32)
    for i, first in enumerate(images):
        for j in range(i + 1, len(images)):
            scores[i, j] = scores[j, i] = _mutual_matches(first, images[j])
    return scores


def choose_pairs(
    scores: NDArray[np.int32], *, exhaustive_images: int, pairs_per_image: int, ordered: bool
) -> list[tuple[int, int]]:
    """Chooses pairs (i, j), i < j, sorted; beyond `exhaustive_images`, best partners and neighbors."""
    count = len(scores)
    if count <= exhaustive_images:
        return [(i, j) for i in range(count) for j in range(i + 1, count)]
    pairs = {(i, i + step) for step in _NEIGHBORS[ordered] for i in range(count - step)}
    for i in range(count):
        best = np.argsort(-scores[i], kind="stable")[:pairs_per_image]
        pairs |= {(min(i, int(j)), max(i, int(j))) for j in best if scores[i, j] > 0}
    return sorted(pairs)


def telling_pairs(count: int) -> list[Pair]:
    """Chooses few informative pairs, sorted: neighbors, and pairs of evenly spread images."""
    spread = np.linspace(0, count - 1, min(count, _SPREAD_IMAGES)).round().astype(int).tolist()
    neighbors = {(i, i + 1) for i in range(count - 1)}
    return sorted(neighbors | {(i, j) for i in spread for j in spread if i < j})


def _mutual_matches(first: NDArray[np.float32], second: NDArray[np.float32]) -> int:
    if len(first) < 2 or len(second) < 2:
        return 0
    cosine = first @ second.T
    rows, nearest = np.arange(len(first)), cosine.argmax(axis=1)
    best = cosine[rows, nearest]
    mutual = best == cosine.max(axis=0)[nearest]  # faster: `argmax` along columns copies them, as slow as the product
    cosine[rows, nearest] = -1.0
    angles = np.arccos(np.clip([best, cosine.max(axis=1)], -1.0, 1.0))
    return int((mutual & (angles[0] < _MAX_RATIO * angles[1])).sum())
