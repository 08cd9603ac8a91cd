"""3D mask IoU: labels of Gaussians, compared with those that true depth and true label maps give them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.evaluation.datasets.types import TrueView
from fastsplat.service.evaluation.segmentation import MaskCounts, mask_counts
from fastsplat.service.evaluation.types import EvaluatedScene, SceneFigure, SceneMetric, Skipped
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.camera import PosedCamera

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
    *,
    relative_tolerance: float = _RELATIVE_TOLERANCE,
) -> NDArray[np.int32]:
    """int32 [G]: the true class of each Gaussian's centre, `NO_TRUTH` where no view's surface is there.

    A view votes for a Gaussian when the centre falls on a pixel whose true depth differs from the centre's by at most
    `relative_tolerance` of it; the vote is that pixel's label. Most votes win, ties go to the lower class.

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
        near = (true_z > 0) & (np.abs(z[visible] - true_z) <= relative_tolerance * true_z)
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


def measure_mask3d_iou(scene: EvaluatedScene) -> SceneFigure | Skipped:
    """The macro IoU over Gaussians on the surfaces that the test views show."""
    views = [view for view in scene.dataset.test if view.posed is not None and view.labels is not None]
    if not views:
        return Skipped("no test view has a label map and a pose")
    with_depth = [view for view in views if view.depth is not None]
    surfaces = [_surface(scene.index, view) for view in with_depth or views]
    labels = len(scene.dataset.dictionary)
    truth = gaussian_truth(scene.index.scene.gaussians.means, surfaces, labels)
    counts = mask3d_counts(scene.to_truth[scene.index.gaussian_classes], truth, labels)
    if not counts.present().any():
        return Skipped("no Gaussian lies on a labelled surface of a test view")
    source = "true depth" if with_depth else "the scene's own depth"
    details = {
        "mask3d_gaussians": int(counts.counts[:, 1].sum()),
        "mask3d_truth": f"Gaussians whose center lies within 2 % of {source} in a test view, labelled by the test "
        "views' label maps",
    }
    return SceneFigure(counts.macro_iou(), counts.iou(), details)


def _surface(index: SceneIndex, view: TrueView) -> TrueSurface:
    assert view.posed is not None and view.labels is not None
    depth = index.depth(view.posed) if view.depth is None else view.depth
    return TrueSurface(view.posed, depth if view.valid is None else np.where(view.valid, depth, 0), view.labels)


MASK3D_IOU = SceneMetric(
    name="mask3d_iou",
    unit="",
    higher_is_better=True,
    description="IoU of the labels of Gaussians (centers, not weighted by size or opacity), mean over the labels that "
    "the truth shows; a measure of this project's own",
    measure=measure_mask3d_iou,
    parameters={"relative_tolerance": _RELATIVE_TOLERANCE},
    headline=True,
)
