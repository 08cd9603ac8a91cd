"""3D mask IoU: labels of Gaussians, compared with those that true depth and true label maps give them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.evaluation.segmentation import MaskCounts, mask_counts
from fastsplat_contract.geometry.camera import PosedCamera

NO_TRUTH = -1
_RELATIVE_TOLERANCE = 0.02


@dataclass(frozen=True)
class TrueSurface:
    """The true surface in one view.

    Attributes:
        posed: its camera.
        depth: float [H, W], camera z in scene units, 0 where unknown.
        labels: int [H, W], classes 0..N.
    """

    posed: PosedCamera
    depth: NDArray[np.floating]
    labels: NDArray[np.integer]


def gaussian_truth(
    means: NDArray[np.floating],
    surfaces: Sequence[TrueSurface],
    labels: int,
) -> NDArray[np.int32]:
    """int32 [G]: the true class of each Gaussian's centre, `NO_TRUTH` where no view's surface is there.

    A view votes for a Gaussian when the centre falls on a pixel whose true depth differs from the centre's by at most
    2 % of it; the vote is that pixel's label. Most votes win, ties go to the lower class.

    Args:
        means: [G, 3], world frame, the frame of the views' poses.
        surfaces: the views.
        labels: N.
    """
    votes = [np.zeros(0, np.int64)]  # Gaussian · (N + 1) + class, one a view that sees it
    points = np.asarray(means, np.float64)
    for surface in surfaces:
        camera = surface.posed.camera
        rotation, translation = np.split(surface.posed.camera_from_world()[:3], [3], axis=1)
        x, y, z = (points @ rotation.T + translation[:, 0]).T
        front = np.flatnonzero(z > 0)
        column = np.floor(camera.fx * x[front] / z[front] + camera.cx)
        row = np.floor(camera.fy * y[front] / z[front] + camera.cy)
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        rows, columns, visible = row[inside].astype(np.intp), column[inside].astype(np.intp), front[inside]
        true_z = surface.depth[rows, columns]
        near = (true_z > 0) & (np.abs(z[visible] - true_z) <= _RELATIVE_TOLERANCE * true_z)
        classes = surface.labels[rows[near], columns[near]].astype(np.int64)
        votes.append(visible[near] * (labels + 1) + classes)
    pairs, counts = np.unique(np.concatenate(votes), return_counts=True)
    gaussian, label = np.divmod(pairs, labels + 1)
    best_last = np.lexsort((-label, counts, gaussian))
    truth = np.full(len(means), NO_TRUTH, np.int32)
    truth[gaussian[best_last]] = label[best_last]  # of several values for one row, the last stays
    return truth


def mask3d_counts(predicted: NDArray[np.integer], truth: NDArray[np.integer], labels: int) -> MaskCounts:
    """Counts of Gaussians [G] whose truth is known; `iou` is the 3D mask IoU of each label."""
    known = truth != NO_TRUTH
    return mask_counts(predicted[known], truth[known], labels)
