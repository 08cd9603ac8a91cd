"""A scene that is known exactly scores perfectly; a wrong one does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.evaluation.held_out_views import evaluate_views
from benchmarks.evaluation.predictions import silhouette
from benchmarks.training.posed_folder import load_posed_folder
from fastsplat.service.capture.captures import Capture
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.scene import SemanticHead
from fastsplat.service.splatting.raster import cuda
from fastsplat_contract.errors import InvalidInputError
from tests.benchmarks.evaluation import made_data
from tests.splatting import pretend_gpu

SCENE = made_data.scene()
BOTH = SCENE.gaussians, SCENE.head
NAME = "000.png"


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> tuple[Capture, Labelling]:
    return load_posed_folder(made_data.nerfstudio(tmp_path_factory.mktemp("truth") / "made", 2))


def test_the_truth_scores_perfectly_and_swapped_codes_lose_meaning_but_not_color(truth) -> None:
    report = evaluate_views(*BOTH, *truth, ["001.png", NAME], backend="reference")
    assert report.psnr > 50 and report.mean_iou == 1
    assert report.iou == dict.fromkeys(made_data.LABELS, 1)
    swapped = replace(SCENE.gaussians, codes=np.roll(SCENE.gaussians.codes, 1, axis=0))
    report = evaluate_views(swapped, SCENE.head, *truth, [NAME], backend="reference")
    assert report.psnr > 50 and report.mean_iou == 0


def test_a_gpu_is_measured_as_the_cpu_is(truth, gsplat_on_cpu: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda, "DEVICE", pretend_gpu.DEVICE)
    posed, rows = truth[0].views[0].posed, np.ones(3, bool)
    with pretend_gpu.pretended():
        ours, theirs = (evaluate_views(*BOTH, *truth, [NAME], backend=name) for name in ("cpu", "cuda"))
        covered = [silhouette(SCENE.gaussians, rows, posed, name) for name in ("cpu", "cuda")]
    assert theirs.psnr == pytest.approx(ours.psnr, abs=0.01) and theirs.mean_iou == ours.mean_iou
    assert np.mean(covered[0] == covered[1]) > 0.98 and covered[0].any()


def test_views_and_heads_that_do_not_belong_are_refused(truth) -> None:
    with pytest.raises(InvalidInputError, match="nowhere"):
        evaluate_views(*BOTH, *truth, ["nowhere.png"], backend="reference")
    head = SemanticHead(np.zeros((5, 3), np.float32), np.zeros(5, np.float32))
    with pytest.raises(InvalidInputError, match="5 classes for 3 labels"):
        evaluate_views(SCENE.gaussians, head, *truth, [NAME], backend="reference")
