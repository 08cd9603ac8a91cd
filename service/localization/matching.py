"""Matches a photo's keypoints with landmarks: cheap votes pick the views to match in full."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.localization.keypoints import Keypoints, unit_rows
from fastsplat.service.localization.landmarks import Landmarks

_VOTERS = 250
_HEARD = 60_000  # landmarks used in votes, the strongest of each view
_RATIO = 0.85
"""Limit of a match's distance over the second best's (Lowe, IJCV 2004)."""


@dataclass(frozen=True)
class Matches:
    """M keypoint-landmark pairs; a keypoint may match in several views."""

    keypoints: NDArray[np.int64]  # [M], rows of the keypoints
    landmarks: NDArray[np.int64]  # [M], rows of the landmarks

    def __len__(self) -> int:
        return len(self.keypoints)


def find_matches(landmarks: Landmarks, keypoints: Keypoints, views: int) -> Matches:
    """Matches a photo with the `views` most similar photos of the scene."""
    nothing = np.zeros(0, np.int64)
    pairs = [(nothing, nothing)]
    if len(keypoints) > 1:
        descriptors = unit_rows(keypoints.descriptors)
        pairs += [_matched(landmarks, descriptors, view) for view in likest_views(landmarks, descriptors, views)]
    return Matches(np.concatenate([rows for rows, _ in pairs]), np.concatenate([points for _, points in pairs]))


def likest_views(landmarks: Landmarks, descriptors: NDArray[np.float32], count: int) -> list[int]:
    """Ranks the scene's photos by similarity to a query photo.

    Each strong keypoint votes by how far its best similarity in a view exceeds the median over all views.

    Args:
        descriptors: [K, 128], of length 1, the strongest first.
    """
    sizes = np.diff(landmarks.starts)
    there = np.flatnonzero(sizes)
    if len(there) <= count:
        return [int(view) for view in there]
    per_view = max(1, _HEARD // len(there))
    rows = [np.arange(landmarks.starts[view], landmarks.starts[view] + min(per_view, sizes[view])) for view in there]
    starts = np.cumsum([0, *(len(part) for part in rows)])[:-1]
    likeness = descriptors[:_VOTERS] @ unit_rows(landmarks.descriptors[np.concatenate(rows)]).T
    best = np.maximum.reduceat(likeness, starts, axis=1)
    votes = np.maximum(best - np.median(best, axis=1, keepdims=True), 0.0).sum(axis=0)
    return [int(there[row]) for row in np.argsort(-votes, kind="stable")[:count]]


def _matched(
    landmarks: Landmarks, descriptors: NDArray[np.float32], view: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    start, end = int(landmarks.starts[view]), int(landmarks.starts[view + 1])
    if end - start < 2:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    rows, neighbors = mutual_matches(descriptors, unit_rows(landmarks.descriptors[start:end]))
    return rows, start + neighbors


def mutual_matches(
    descriptors: NDArray[np.float32], candidates: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Mutual nearest neighbors that pass the ratio test; unit descriptors, at least two `candidates`."""
    likeness = descriptors @ candidates.T
    first = likeness.argmax(axis=1)
    every = np.arange(len(descriptors))
    nearest = likeness[every, first]
    back = likeness.argmax(axis=0)
    likeness[every, first] = -1.0
    second = likeness.max(axis=1)
    # Squared distances of unit vectors are 2 - 2 times the likeness.
    clear = (1 - nearest) < _RATIO**2 * (1 - second)
    rows = np.flatnonzero(clear & (back[first] == every))
    return rows.astype(np.int64), first[rows].astype(np.int64)
