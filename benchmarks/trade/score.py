"""Figures of a scene on test views: the functions of `benchmarks.evaluation`."""

from __future__ import annotations

import numpy as np

from benchmarks.evaluation.boundary_iou import boundary_counts
from benchmarks.evaluation.image_quality import psnr, ssim
from benchmarks.evaluation.localization import box_of, peak_in_box
from benchmarks.evaluation.metrics import Skipped, mean
from benchmarks.evaluation.predictions import truth_ids
from benchmarks.evaluation.segmentation import MaskCounts, mask_counts
from benchmarks.trade.bench_captures import BenchData
from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.perception.results import Labelling
from fastsplat.service.query.scene_index import SceneIndex


def score(index: SceneIndex, data: BenchData, prompts_only: bool) -> dict[str, float]:
    """psnr, ssim, miou, boundary_iou of the test views at the images' own size.

    Args:
        index: the scene; each of its labels counts as the truth's label of the same name, others count as undetected.
        data: the truth.
        prompts_only: only the labels that the detector was prompted with count in the means.
    """
    classes = len(data.truth.dictionary)
    to_truth = truth_ids(index.scene.dictionary, data.truth.dictionary)
    pixels, edges = MaskCounts.zeros(classes), MaskCounts.zeros(classes)
    qualities: dict[str, list[float]] = {"psnr": [], "ssim": []}
    for position in data.test:
        view = data.capture.views[position]
        target = load_rgb(view.image_path).astype(np.float32) / 255
        image = index.render(view.posed).astype(np.float32) / 255
        for name, quality in (("psnr", psnr(image, target)), ("ssim", ssim(image, target))):
            if not isinstance(quality, Skipped):
                qualities[name].append(quality)
        predicted, truth = to_truth[index.label_map(view.posed)], data.truth.label_maps[position].astype(np.int64)
        pixels += mask_counts(predicted, truth, classes)
        edges += boundary_counts(predicted, truth, classes)
    rows = [row for row in _counted(data, prompts_only) if pixels.present()[row]]
    iou = pixels.iou()[rows]
    return {
        **{name: mean(values) for name, values in qualities.items()},
        "miou": float(iou.mean()),
        "worst_iou": float(iou.min()),
        "boundary_iou": float(np.nan_to_num(edges.iou()[rows]).mean()),
    }


def localization(index: SceneIndex, data: BenchData, prompts_only: bool) -> float:
    """Share of (label, test view) pairs that show the label, whose relevancy peaks in the label's box (LERF)."""
    names = [entry.label for entry in data.truth.dictionary.entries]
    rows = _counted(data, prompts_only)
    answers = dict(zip(rows, index.ask([names[row - 1] for row in rows]), strict=True))
    hits = []
    for position in data.test:
        truth = data.truth.label_maps[position]
        for row in rows:
            box = box_of(truth == row)
            if box is not None:
                mask = index.mask2d(answers[row], data.capture.views[position].posed)
                hits.append(peak_in_box(mask.relevancy, [box]))
    return float(np.mean(hits))


def maps_iou(labelling: Labelling, data: BenchData) -> float:
    """Mean IoU of detected maps themselves, over the training views and the labels that the detector was prompted
    with."""
    classes, to_truth = len(data.truth.dictionary), truth_ids(labelling.dictionary, data.truth.dictionary)
    total = MaskCounts.zeros(classes)
    for position in data.train:
        truth = data.truth.label_maps[position].astype(np.int64)
        total += mask_counts(to_truth[labelling.label_maps[position]], truth, classes)
    return float(total.iou()[[row for row in _counted(data, True) if total.present()[row]]].mean())


def _counted(data: BenchData, prompts_only: bool) -> list[int]:
    entries = enumerate(data.truth.dictionary.entries, start=1)
    return [row for row, entry in entries if not prompts_only or entry.label in data.prompts]
