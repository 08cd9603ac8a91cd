"""Figures of a scene on test views: the measures of `service.evaluation` over whatever draws the scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.trade.data import BenchData
from fastsplat.service.capture.images import load_rgb
from fastsplat.service.common.dictionary import Dictionary, label_key
from fastsplat.service.evaluation.boundary import boundary_counts
from fastsplat.service.evaluation.ghosts import GhostCounts, ghost_counts
from fastsplat.service.evaluation.localization import box_of, peak_in_box
from fastsplat.service.evaluation.masks import MaskCounts
from fastsplat.service.evaluation.segmentation import confusion
from fastsplat.service.perception.types import Labelling
from fastsplat.service.query import SceneIndex
from fastsplat.service.splatting.quality import psnr, ssim
from fastsplat_contract.camera import PosedCamera

Map = Callable[[PosedCamera], NDArray[np.generic]]


@dataclass(frozen=True)
class Pictures:
    """How a scene is drawn: uint8 [H, W, 3] colours, and integer [H, W] label maps in the scene's own dictionary."""

    colours: Map
    labels: Map


def score(pictures: Pictures, dictionary: Dictionary, data: BenchData, asked_only: bool) -> dict[str, float]:
    """psnr, ssim, miou, boundary_iou, ghost_rate of the test views at the images' own size.

    Args:
        pictures: the scene.
        dictionary: its labels; they are held against the truth's of the same name, others count as undetected.
        data: the truth.
        asked_only: only the labels that the detector was asked for count in the means.
    """
    classes = len(data.truth.dictionary)
    to_truth = _by_name(dictionary, data.truth.dictionary)
    pixels, edges, ghosts = _nothing(classes), _nothing(classes), GhostCounts(0, 0, 0, 0)
    likeness = []
    for position in data.test:
        view = data.capture.views[position]
        target = torch.from_numpy(load_rgb(view.image_path).copy()).float() / 255
        image = torch.from_numpy(np.asarray(pictures.colours(view.posed))).float() / 255
        likeness.append((psnr(image, target), ssim(image, target)))
        found, truth = to_truth[pictures.labels(view.posed)], data.truth.label_maps[position].astype(np.int64)
        pixels += confusion(found, truth, classes).masks()
        edges += boundary_counts(found, truth, classes)
        ghosts += ghost_counts(found, truth, classes)
    seen = [row for row in _counted(data, asked_only) if pixels.present()[row]]
    iou = pixels.iou()
    return {
        "psnr": float(np.mean([pair[0] for pair in likeness])),
        "ssim": float(np.mean([pair[1] for pair in likeness])),
        "miou": float(iou[seen].mean()),
        "worst_iou": float(iou[seen].min()),
        "boundary_iou": float(np.nan_to_num(edges.iou()[seen]).mean()),
        "ghost_rate": ghosts.rate(),
        "ghost_share": ghosts.share_of_pixels(),
    }


def localization(index: SceneIndex, data: BenchData, asked_only: bool) -> float:
    """Share of (label, test view) pairs that show the label, whose relevancy peaks in the label's box (LERF)."""
    names = [entry.label for entry in data.truth.dictionary.entries]
    rows = _counted(data, asked_only)
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
    """Mean IoU of detected maps themselves, over the training views and the labels that were asked for."""
    classes, to_truth = len(data.truth.dictionary), _by_name(labelling.dictionary, data.truth.dictionary)
    total = _nothing(classes)
    for position in data.train:
        found, truth = to_truth[labelling.label_maps[position]], data.truth.label_maps[position].astype(np.int64)
        total += confusion(found, truth, classes).masks()
    return float(total.iou()[[row for row in _counted(data, True) if total.present()[row]]].mean())


def _counted(data: BenchData, asked_only: bool) -> list[int]:
    entries = enumerate(data.truth.dictionary.entries, start=1)
    return [row for row, entry in entries if not asked_only or entry.label in data.asked]


def _nothing(classes: int) -> MaskCounts:
    return MaskCounts(np.zeros((classes + 1, 3), np.int64))


def _by_name(own: Dictionary, truth: Dictionary) -> NDArray[np.int64]:
    ids = {label_key(entry.label): row for row, entry in enumerate(truth.entries, start=1)}
    return np.array([0, *(ids.get(label_key(entry.label), 0) for entry in own.entries)], np.int64)
