"""Which landmarks a photo shows: a cheap vote over all photos of the scene, then the best of them in full."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.localization.keypoints import Keypoints, unit_rows
from fastsplat.service.localization.landmarks import Landmarks

_VOTERS = 250
_HEARD = 60_000
"""Landmarks that are voted on, at most, the strongest of each photo."""
_RATIO = 0.85
"""A match is nearer than so many times the next best of the same photo (Lowe, IJCV 2004)."""


@dataclass(frozen=True)
class Matches:
    """M pairs of a keypoint of a photo and a landmark; a keypoint may have several, in different photos of the scene.

    Attributes:
        keypoints: int64 [M], rows of the keypoints.
        landmarks: int64 [M], rows of the landmarks.
    """

    keypoints: NDArray[np.int64]
    landmarks: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.keypoints)


def find_matches(landmarks: Landmarks, keypoints: Keypoints, views: int) -> Matches:
    """The matches of a photo with those of the scene's photos that are likest to it."""
    nothing = np.zeros(0, np.int64)
    pairs = [(nothing, nothing)]
    if len(keypoints) > 1:
        asked = unit_rows(keypoints.descriptors)
        pairs += [_matched(landmarks, asked, view) for view in likest_views(landmarks, asked, views)]
    return Matches(np.concatenate([one for one, _ in pairs]), np.concatenate([other for _, other in pairs]))


def likest_views(landmarks: Landmarks, asked: NDArray[np.float32], count: int) -> list[int]:
    """The photos of the scene that have most in common with another one, the likest first. Each of its strongest
    keypoints votes by how much likelier it finds itself there than in the middle one of all photos.

    Args:
        asked: float32 [K, 128], descriptors of length 1, the strongest first.
    """
    sizes = np.diff(landmarks.starts)
    there = np.flatnonzero(sizes)
    if len(there) <= count:
        return [int(view) for view in there]
    each = max(1, _HEARD // len(there))
    rows = [np.arange(landmarks.starts[view], landmarks.starts[view] + min(each, sizes[view])) for view in there]
    starts = np.cumsum([0, *(len(part) for part in rows)])[:-1]
    likeness = asked[:_VOTERS] @ unit_rows(landmarks.descriptors[np.concatenate(rows)]).T
    best = np.maximum.reduceat(likeness, starts, axis=1)
    votes = np.maximum(best - np.median(best, axis=1, keepdims=True), 0.0).sum(axis=0)
    return [int(there[row]) for row in np.argsort(-votes, kind="stable")[:count]]


def _matched(
    landmarks: Landmarks, asked: NDArray[np.float32], view: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    start, end = int(landmarks.starts[view]), int(landmarks.starts[view + 1])
    if end - start < 2:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    rows, others = mutual_matches(asked, unit_rows(landmarks.descriptors[start:end]))
    return rows, start + others


def mutual_matches(
    asked: NDArray[np.float32], others: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of descriptors of length 1, [K, 128] and [L, 128], L at least 2, each the other's best, and clearly so."""
    likeness = asked @ others.T
    first = likeness.argmax(axis=1)
    every = np.arange(len(asked))
    nearest = likeness[every, first]
    back = likeness.argmax(axis=0)
    likeness[every, first] = -1.0
    second = likeness.max(axis=1)
    # Of descriptors of length 1, squared distances are 2 - 2 times the likeness.
    clear = (1 - nearest) < _RATIO**2 * (1 - second)
    rows = np.flatnonzero(clear & (back[first] == every))
    return rows.astype(np.int64), first[rows].astype(np.int64)
