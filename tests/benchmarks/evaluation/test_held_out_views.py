"""A scene that is known exactly scores perfectly; a wrong one does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.evaluation.held_out_views import evaluate_views, render_view
from benchmarks.evaluation.predictions import silhouette
from fastsplat.service.capture.captures import Capture, CaptureReport, View
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.scene import Gaussians, SemanticHead
from fastsplat.service.splatting.raster import cuda
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.scenes import labelled_scene
from tests.splatting import pretend_gpu

HEAD = SemanticHead(np.eye(3, dtype=np.float32) * 8, np.array([2, 0, 0], np.float32))


def _scene() -> Gaussians:
    """A red and a green blob in front of the camera, labels 1 and 2."""
    colors = [[[1.5, -1.5, -1.5]], [[-1.5, 1.5, -1.5]]]
    places = [[-0.3, 0, 2], [0.3, 0, 2]]
    return labelled_scene(places, [1, 2], ("apple", "pear"), scales=0.15, logit_opacities=5.0, sh=colors).gaussians


@pytest.fixture
def truth(tmp_path: Path) -> tuple[Capture, Labelling]:
    camera = Camera(40, 30, 40, 40, 20, 15)
    views, maps = [], []
    for index in range(2):
        pose = np.eye(4)
        pose[0, 3] = 0.1 * index
        posed = PosedCamera(camera, pose, f"{index}.png")
        rgb, classes = render_view(_scene(), HEAD, posed, backend="reference")
        Image.fromarray((rgb.clamp(0, 1) * 255).round().byte().numpy()).save(tmp_path / posed.name)
        views.append(View(posed, tmp_path / posed.name))
        maps.append(classes.astype(np.uint16))
    capture = Capture(
        tuple(views), np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), "METRIC", CaptureReport("images", 2)
    )
    return capture, Labelling(dictionary_of(["apple", "pear"]), tuple(maps))


def test_the_truth_scores_perfectly(truth) -> None:
    report = evaluate_views(_scene(), HEAD, *truth, ["1.png", "0.png"], backend="reference")
    assert report.psnr > 50 and report.mean_iou == 1
    assert report.iou == {"apple": 1, "pear": 1}


def test_swapped_codes_lose_meaning_but_not_colour(truth) -> None:
    scene = _scene()
    scene.codes[:] = scene.codes[::-1].copy()
    report = evaluate_views(scene, HEAD, *truth, ["0.png"], backend="reference")
    assert report.psnr > 50
    assert report.mean_iou == 0


def test_a_gpu_is_measured_as_the_cpu_is(truth, gsplat_on_cpu: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda, "DEVICE", pretend_gpu.DEVICE)
    posed, both = truth[0].views[0].posed, np.ones(2, bool)
    with pretend_gpu.pretended():
        ours, theirs = (evaluate_views(_scene(), HEAD, *truth, ["0.png"], backend=name) for name in ("cpu", "cuda"))
        covered = [silhouette(_scene(), both, posed, name) for name in ("cpu", "cuda")]
    assert theirs.psnr == pytest.approx(ours.psnr, abs=0.01) and theirs.mean_iou == ours.mean_iou
    assert np.mean(covered[0] == covered[1]) > 0.98 and covered[0].any()


def test_views_and_heads_that_do_not_belong_are_refused(truth) -> None:
    with pytest.raises(InvalidInputError, match="nowhere"):
        evaluate_views(_scene(), HEAD, *truth, ["nowhere.png"], backend="reference")
    head = SemanticHead(np.zeros((4, 3), np.float32), np.zeros(4, np.float32))
    with pytest.raises(InvalidInputError, match="4 classes for 2 labels"):
        evaluate_views(_scene(), head, *truth, ["0.png"], backend="reference")
