"""A trained scene against the test split of a data set."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.progress import Progress, ProgressEvent, silent
from fastsplat.service.evaluation.absence import RECALL, Absence, ask_all, measure_absence
from fastsplat.service.evaluation.absent import AbsentList, absent_nouns
from fastsplat.service.evaluation.bootstrap import Interval, bootstrap_interval
from fastsplat.service.evaluation.boundary import DIAGONAL_SHARE
from fastsplat.service.evaluation.datasets.types import Dataset, TrueView
from fastsplat.service.evaluation.ghosts import EDGE_PX, NEAR_PX, GhostCounts
from fastsplat.service.evaluation.guard import check_unseen
from fastsplat.service.evaluation.masks import MaskCounts
from fastsplat.service.evaluation.report import Report
from fastsplat.service.evaluation.scoring import ViewScore, score_view, texts_of
from fastsplat.service.evaluation.solid import TrueSurface, gaussian_truth, mask3d_counts
from fastsplat.service.query import SceneIndex
from fastsplat.service.scene.types import Scene

_Scores = Sequence[ViewScore]
_NAN = float("nan")

Watch = Callable[[TrueView, ViewScore], None]
"""Sees every view with its score, e.g. to draw it."""


def evaluate_scene(
    index: SceneIndex,
    dataset: Dataset,
    *,
    diagonal_share: float = DIAGONAL_SHARE,
    samples: int = 1000,
    seconds: Mapping[str, float] | None = None,
    scene_bytes: int | None = None,
    peak_mb: float = _NAN,
    progress: Progress = silent,
    watch: Watch = lambda view, score: None,
) -> Report:
    """Scores the test views; the order of them changes nothing.

    A label of the data set that the scene does not have is a missing prediction and counts as zero. A label of the
    scene that the data set does not have counts as no label.

    Args:
        index: the scene, with the text encoder and threshold that it is to be asked with.
        dataset: see `service.evaluation.datasets.read_dataset`.
        diagonal_share: width of the boundary region, see `service.evaluation.boundary`.
        samples: bootstrap draws; 0 leaves the intervals out.
        seconds: by stage, of what was done before; the stage "scoring" is added.
        scene_bytes: on disk; by default that of the arrays.
        peak_mb: memory of the process that trained.
        progress: hears of every view, stage "scoring".
        watch: sees every view with its score.

    Raises:
        InvalidInputError: the scene was trained on a test view, or lies in another world frame than the data set.
    """
    began = time.perf_counter()
    check_unseen(index.scene, dataset)
    labels = tuple(entry.label for entry in dataset.dictionary.entries)
    to_truth = _ids_in(index.scene, dataset)
    texts = sorted({text for view in dataset.test for text in texts_of(view, dataset.dictionary)})
    answers = dict(zip(texts, ask_all(index, texts), strict=True))
    scores = []
    for number, view in enumerate(sorted(dataset.test, key=lambda view: view.name)):
        progress(ProgressEvent("scoring", number / len(dataset.test), f"view {number + 1}/{len(dataset.test)}"))
        score = score_view(index, view, dataset.dictionary, to_truth, answers, diagonal_share=diagonal_share)
        watch(view, score)
        scores.append(score)
    figures = {name: measure(scores) for name, measure in _FIGURES.items()}
    solid, solid_truth = _mask3d(index, dataset, to_truth, len(labels))
    known = [*labels, *(entry.label for entry in index.scene.dictionary.entries)]
    far, near = (measure_absence(index, texts, absent_nouns(known, which)) for which in _LISTS)
    progress(ProgressEvent("scoring", 1.0, "intervals"))
    details: dict[str, Any] = {
        **{name: value for name, value in figures.items() if name not in _MAIN},
        "localization_peak_in_box": figures["localization"],
        "boundary_iou_per_class": _by_label(_pooled(scores, "boundary").iou(), labels),
        "miou_threshold_per_class": _by_label(_pooled(scores, "threshold").iou(), labels),
        "mask3d_iou_per_class": {} if solid is None else _by_label(solid.iou(), labels),
        "mask3d_gaussians": 0 if solid is None else int(solid.counts[:, 1].sum()),
        "mask3d_truth": solid_truth,
        "absent": _absence(far),
        "absent_household": _absence(near),
        "views": [_view(score) for score in scores],
        "bytes_per_gaussian": (scene_bytes or scene_size(index.scene)) / max(1, len(index.scene.gaussians)),
        "label_mode": index.scene.label_mode,
        "dataset": {
            "name": dataset.folder.name,
            "kind": dataset.kind,
            "train_views": len(dataset.train),
            "test_views": len(dataset.test),
            "labels": len(labels),
            "notes": list(dataset.notes),
        },
        "thresholds": {
            "boundary_diagonal_share": diagonal_share,
            "ghost_edge_px": EDGE_PX,
            "ghost_near_px": NEAR_PX,
            "alpha_min": index.settings.alpha_min,
            "absent_recall": RECALL,
            "score": index.settings.score,
            "text_encoder": index.scene.text_encoder[0],
            "encoder_calibrated": index.calibrated,
        },
    }
    return Report(
        **{name: figures[name] for name in _MAIN},
        miou_per_class=_by_label(_pooled(scores, "closed").iou(), labels),
        mask3d_iou=_NAN if solid is None else solid.macro_iou(),
        absent_auroc=_NAN if far is None else far.auroc,
        gaussians=len(index.scene.gaussians),
        bytes=scene_bytes or scene_size(index.scene),
        seconds={**(seconds or {}), "scoring": time.perf_counter() - began},
        peak_mb=peak_mb,
        intervals=_intervals(scores, samples),
        reasons=_reasons(dataset, figures, solid, peak_mb),
        queries=tuple(query for score in scores for query in score.queries),
        details=details,
    )


def scene_size(scene: Scene) -> int:
    """Bytes of a scene's arrays."""
    arrays = [getattr(scene.gaussians, item.name) for item in fields(scene.gaussians)]
    arrays += [scene.head.weight, scene.head.bias, scene.label_embeddings]
    if scene.evidence is not None:
        arrays += [scene.evidence.starts, scene.evidence.labels, scene.evidence.counts]
    return sum(int(array.nbytes) for array in arrays)


_LISTS: tuple[AbsentList, AbsentList] = ("nouns", "household")


def _pooled(scores: _Scores, which: str) -> MaskCounts:
    counts: list[MaskCounts] = [getattr(score, which) for score in scores]
    return sum(counts[1:], counts[0])


def _ghosts(scores: _Scores) -> GhostCounts:
    found = [score.ghosts for score in scores if score.ghosts is not None]
    return sum(found, GhostCounts(0, 0, 0, 0))


def _over_queries(scores: _Scores, which: str) -> float:
    return _mean([float(getattr(query, which)) for score in scores for query in score.queries])


def _over_depths(scores: _Scores, which: str) -> float:
    return _mean([float(getattr(score.depth, which)) for score in scores if score.depth is not None])


def _mean(values: Sequence[float | None]) -> float:
    there = [value for value in values if value is not None]
    return math.fsum(there) / len(there) if there else _NAN


_FIGURES: Mapping[str, Callable[[_Scores], float]] = {
    "miou": lambda scores: _pooled(scores, "closed").macro_iou(),
    "boundary_iou": lambda scores: _pooled(scores, "boundary").macro_iou(),
    "localization": lambda scores: _over_queries(scores, "peak_in_box"),
    "pixel_accuracy": lambda scores: _pooled(scores, "closed").accuracy(),
    "ghost_rate": lambda scores: _ghosts(scores).rate(),
    "psnr": lambda scores: _mean([score.psnr for score in scores]),
    "ssim": lambda scores: _mean([score.ssim for score in scores]),
    "depth_error": lambda scores: _over_depths(scores, "abs_rel"),
    "miou_micro": lambda scores: _pooled(scores, "closed").micro_iou(),
    "miou_views": lambda scores: _over_queries(scores, "iou"),
    "miou_threshold": lambda scores: _pooled(scores, "threshold").macro_iou(),
    "miou_threshold_micro": lambda scores: _pooled(scores, "threshold").micro_iou(),
    "miou_threshold_views": lambda scores: _over_queries(scores, "iou_threshold"),
    "boundary_iou_micro": lambda scores: _pooled(scores, "boundary").micro_iou(),
    "localization_peak_in_mask": lambda scores: _over_queries(scores, "peak_in_mask"),
    "ghost_rate_named": lambda scores: _ghosts(scores).named_rate(),
    "ghost_share_of_pixels": lambda scores: _ghosts(scores).share_of_pixels(),
    "depth_median_abs": lambda scores: _over_depths(scores, "median_abs"),
    "depth_coverage": lambda scores: _over_depths(scores, "coverage"),
}
_MAIN = (
    "miou", "boundary_iou", "localization", "pixel_accuracy", "ghost_rate", "psnr", "ssim", "depth_error",
)  # fmt: skip


def _intervals(scores: _Scores, samples: int) -> dict[str, Interval | None]:
    if not samples:
        return {}
    return {name: bootstrap_interval(scores, measure, samples=samples) for name, measure in _FIGURES.items()}


def _ids_in(scene: Scene, dataset: Dataset) -> NDArray[np.int32]:
    names = [(entry.label, *entry.aliases) for entry in scene.dictionary.entries]
    ids = [next((found for name in group if (found := dataset.dictionary.id_of(name))), 0) for group in names]
    return np.array([0, *ids], np.int32)


def _mask3d(
    index: SceneIndex, dataset: Dataset, to_truth: NDArray[np.int32], labels: int
) -> tuple[MaskCounts | None, str]:
    seen = [view for view in dataset.test if view.posed is not None and view.labels is not None]
    if not seen:
        return None, "none: no test view has a label map"
    true_depth = [view for view in seen if view.depth is not None]
    surfaces = []
    for view in true_depth or seen:
        assert view.posed is not None and view.labels is not None
        depth = index.depth(view.posed) if view.depth is None else view.depth
        visible = depth if view.valid is None else np.where(view.valid, depth, 0)
        surfaces.append(TrueSurface(view.posed, visible, view.labels))
    truth = gaussian_truth(index.scene.gaussians.means, surfaces, labels)
    source = "true depth" if true_depth else "the scene's own depth"
    predicted = to_truth[index.gaussian_classes]
    return (
        mask3d_counts(predicted, truth, labels),
        f"Gaussians whose centre lies within 2 % of {source} in a test view, labelled by the test views' label maps",
    )


def _absence(found: Absence | None) -> dict[str, Any]:
    return {} if found is None else {item.name: getattr(found, item.name) for item in fields(found)}


def _by_label(values: NDArray[np.float64], labels: Sequence[str]) -> dict[str, float]:
    return dict(zip(labels, values[1:].tolist(), strict=True))


def _view(score: ViewScore) -> dict[str, Any]:
    own: dict[str, Any] = {"name": score.name, "psnr": score.psnr, "ssim": score.ssim}
    own["miou"] = score.closed.macro_iou()
    own["depth_error"] = None if score.depth is None else score.depth.abs_rel
    return own


def _reasons(
    dataset: Dataset, figures: Mapping[str, float], solid: MaskCounts | None, peak_mb: float
) -> dict[str, str]:
    """Why figures are missing."""
    without_maps = f"no test view of {dataset.folder.name} has a label map"
    found = {
        "depth_error": "the data set has no depth maps",
        "ghost_rate": without_maps,
        "mask3d_iou": without_maps,
        "psnr": "no test view has a pose, or the pictures are equal",
        "peak_mb": "nothing was trained here",
        "absent_auroc": "no test view shows a label",
    }
    missing = {name for name, value in figures.items() if not math.isfinite(value)}
    missing |= {"mask3d_iou"} if solid is None else set()
    missing |= {"peak_mb"} if not math.isfinite(peak_mb) else set()
    return {name: found.get(name, "the truth has nothing to measure it on") for name in sorted(missing)}
