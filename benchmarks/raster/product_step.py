"""The time of one optimization step, of `train` itself: what is measured is what the product does."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.raster.garden import Scene
from benchmarks.raster.raster_rows import Row
from fastsplat.service.capture.captures import Capture, CaptureReport, View
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.common.progress import silent
from fastsplat.service.perception.results import Labelling
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.raster.kernels import running_with
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_settings import LearningRates, TrainingSettings
from fastsplat_contract.geometry.camera import PosedCamera

_WARM_UP = 5  # steps: images are converted and memory is taken in the first of them
_STILL = LearningRates(
    means=1e-9, means_final=1e-9, quats=1e-9, log_scales=1e-9, logit_opacities=1e-9, sh_dc=1e-9, codes=1e-9, weight=1e-9
)
"""Rates at which every parameter is updated and none moves, so that all steps render the same scene."""


def step_row(scene: Scene, isa: str, threads: int, labels: int = 20, rounds: int = 15) -> Row:
    """A row of the table: the mean of 3 · rounds steps."""
    with running_with(isa=isa, threads=threads):
        milliseconds = step_milliseconds(scene, labels, 3 * rounds)
    camera = scene.camera
    return Row(
        "cpu",
        isa,
        threads,
        len(scene.splats.means),
        camera.width,
        camera.height,
        scene.splats.features.shape[1],
        None,
        None,
        round(milliseconds, 3),
        None,
    )


def step_milliseconds(scene: Scene, labels: int, steps: int, backend: Backend = "cpu") -> float:
    """Mean time of a step with harmonics of degree 1, codes, both losses, both decays and Adam; warmed up.

    Args:
        scene: its Gaussians' means are where the training's start, as many of them; its camera is the only view's; its
            features are 3 colors and the code.
        labels: of the cross-entropy, which enters every step.
        steps: that are timed.
        backend: of the rasterizer.
    """
    with tempfile.TemporaryDirectory() as folder:
        capture, labelling = _capture(scene, labels, Path(folder))
        _, few, many = (
            train(capture, labelling, _settings(scene, iterations, backend), silent).quality["train_seconds"]
            for iterations in (_WARM_UP, _WARM_UP, _WARM_UP + steps)  # the first run loads and compiles kernels
        )
    return 1e3 * (many - few) / steps


def _settings(scene: Scene, iterations: int, backend: Backend) -> TrainingSettings:
    return TrainingSettings(
        backend=backend,
        iterations=iterations,
        time_budget_s=None,
        max_gaussians=len(scene.splats.means),
        max_side=max(scene.camera.width, scene.camera.height),
        start_scale=1.0,
        max_sh_degree=1,
        sh_from=(0.0, 0.0, 0.0),
        held_out_every=0,
        semantic_every=1,
        depth_spread_weight=0.0,  # terms that other programs do not have
        depth_smoothness_weight=0.0,
        depth_anchor_weight=0.0,
        label_refit_epochs=0,
        label_mode="codes",
        code_size=scene.splats.features.shape[1] - 3,
        densify_events=0,
        evaluations=0,
        rates=_STILL,
    )


def _capture(scene: Scene, labels: int, folder: Path) -> tuple[Capture, Labelling]:
    """One view of noise, each pixel with a random label."""
    random = np.random.default_rng(1)
    camera = scene.camera
    path = folder / "view.png"
    Image.fromarray(random.integers(0, 256, (camera.height, camera.width, 3), dtype=np.uint8)).save(path)
    pose = np.linalg.inv(scene.viewmat.cpu().numpy().astype(np.float64))
    points = scene.splats.means.cpu().numpy()
    capture = Capture(
        views=(View(PosedCamera(camera, pose, path.name), path),),
        points=points,
        point_colors=random.integers(0, 256, points.shape, dtype=np.uint8),
        scale="ARBITRARY",
        report=CaptureReport("images", 1),
    )
    label_map = random.integers(0, labels + 1, (camera.height, camera.width)).astype(np.uint16)
    dictionary = dictionary_of(f"label {number}" for number in range(labels))
    return capture, Labelling(dictionary, (label_map,), exact=True)
