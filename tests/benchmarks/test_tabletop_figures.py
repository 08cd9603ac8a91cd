"""Figures of a short run on the table-top benchmark, so that a change that costs color, labels or depth is noticed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.evaluation.depth_error import depth_error
from benchmarks.evaluation.held_out_views import evaluate_views
from benchmarks.evaluation.mask3d_iou import TrueSurface, gaussian_truth, mask3d_counts
from benchmarks.splits import with_split
from benchmarks.training.posed_folder import load_posed_folder
from fastsplat.service.capture.captures import Capture, View
from fastsplat.service.common.progress import silent
from fastsplat.service.perception.results import Labelling
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training.depth_regularization import depth_spread
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import squared_depths
from fastsplat.workers.kinds.create_scene import load_trained, save_trained
from tests.trained_scenes import trained

_SIDE, _STEPS = 160, 300


def _without_test_views(root: Path) -> tuple[Capture, Labelling, list[int]]:
    """The benchmark's training views with exact label maps, and which of them are measured here."""
    capture, labelling = load_posed_folder(root)
    capture, labelling = with_split(capture, labelling, capture.test_names, "validation")
    return replace(capture, test_names=()), replace(labelling, exact=True), list(range(3, len(capture.views), 8))


def _true_depth(root: Path, view: View) -> NDArray[np.float32]:
    """Camera z, meters; stored as 1e-4 m."""
    document = json.loads((root / "transforms.json").read_text())
    frame = next(frame for frame in document["frames"] if Path(frame["file_path"]).name == view.posed.name)
    raw = cv2.imread(str(root / frame["depth_path"]), cv2.IMREAD_UNCHANGED)
    return raw.astype(np.float32) * 1e-4


def _measure(
    result: TrainedSplats, root: Path, capture: Capture, labelling: Labelling, rows: list[int]
) -> dict[str, float]:
    """At the training size, against pixels of the truth that fall on it; means over the measured views."""
    gaussians, head = result.gaussians, result.head
    splats, classes = splats_of(gaussians), len(labelling.dictionary)
    views = [capture.views[row] for row in rows]
    depth, spread, surfaces = [], [], []
    for row, view in zip(rows, views, strict=True):
        posed, true_depth = view.posed.limited_to(_SIDE), _true_depth(root, view)
        viewmat = torch.from_numpy(posed.camera_from_world().astype(np.float32))
        out = rasterize(replace(splats, features=squared_depths(splats.means, viewmat)), viewmat, posed.camera)
        small = cv2.resize(true_depth, (posed.camera.width, posed.camera.height), interpolation=cv2.INTER_NEAREST)
        depth.append(depth_error((out.depth / out.alpha.clamp_min(1e-6)).numpy(), small))
        spread.append(float(depth_spread(out.alpha, out.depth, out.image[..., -1])))
        surfaces.append(TrueSurface(view.posed, true_depth, labelling.label_maps[row]))
    names = [view.posed.name for view in views]
    report = evaluate_views(gaussians, head, capture, labelling, names, max_side=_SIDE)
    gaussian_labels = (gaussians.codes @ head.weight.T + head.bias).argmax(axis=1)
    masks = mask3d_counts(gaussian_labels, gaussian_truth(gaussians.means, surfaces, classes), classes)
    return {
        "psnr": report.psnr,
        "miou": report.mean_iou,
        "depth_error": float(np.mean(depth)),
        "mask3d_iou": masks.micro_iou(),
        "spread": float(np.mean(spread)),
        "harmonics": float(np.sqrt(np.square(gaussians.sh[:, 1:]).mean())),
    }


def test_a_short_run_keeps_its_color_labels_and_depth(test_data: Path) -> None:
    """Measures four training views; bounds were chosen beside, in brackets, runs without the term in question.

    Depth error 0.031 (0.046 without anchors), spread 0.0119 (0.0155), 3D mask IoU 0.986 (0.948 without the last fit),
    harmonics 0.034 (0.006 at 3DGS's rate), 24.3 dB and mIoU 0.871 (22.2 and 0.850 with 5,000 Gaussians).
    """
    root = test_data / "tabletop"
    capture, labelling, rows = _without_test_views(root)

    def make(folder: Path) -> None:
        training = [row for row in range(len(capture.views)) if row not in rows]
        settings = TrainingSettings(
            time_budget_s=None, iterations=_STEPS, max_side=_SIDE, max_gaussians=8_000, held_out_every=0, evaluations=0
        )
        result = train(
            replace(capture, views=tuple(capture.views[row] for row in training)),
            replace(labelling, label_maps=tuple(labelling.label_maps[row] for row in training)),
            settings,
            silent,
        )
        save_trained(result, folder)

    figures = _measure(load_trained(trained("tabletop_figures", make, root)), root, capture, labelling, rows)
    print(figures)
    assert figures["psnr"] > 23.0
    assert figures["miou"] > 0.84
    assert figures["depth_error"] < 0.040
    assert figures["spread"] < 0.0137
    assert figures["mask3d_iou"] > 0.966
    assert figures["harmonics"] > 0.02
