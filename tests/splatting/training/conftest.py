"""A tiny world of known Gaussians: a chequered floor, a red ball, a blue block, seen by a ring of cameras."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from fastsplat.service.capture.captures import Capture, CaptureReport, View
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.common.progress import ProgressEvent
from fastsplat.service.perception.results import Labelling
from fastsplat.service.splatting.exposure.photometric import correct
from fastsplat.service.splatting.raster.image_formation import Rendering, Splats
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat_contract.errors import CancelledError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.poses import look_at

LABELS = ("floor", "ball", "block")


def _world() -> tuple[np.ndarray, ...]:
    """Means, scales, colors, labels 1 to 3."""
    random = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 12), np.linspace(-1, 1, 12)), -1).reshape(-1, 2)
    floor = np.column_stack([grid, np.zeros(len(grid))])
    shade = 0.35 + 0.4 * ((np.arange(144) // 3 + np.arange(144) // 36) % 2)
    ball = random.normal(size=(60, 3))
    ball = np.array([-0.4, 0.1, 0.3]) + 0.22 * ball / np.linalg.norm(ball, axis=1, keepdims=True)
    block = np.array([0.4, -0.1, 0.25]) + random.uniform(-0.2, 0.2, size=(60, 3))
    means = np.concatenate([floor, ball, block])
    scales = np.concatenate([np.tile([[0.1, 0.1, 0.02]], (144, 1)), np.full((60, 3), 0.06), np.full((60, 3), 0.07)])
    colors = np.concatenate(
        [np.repeat(shade[:, None], 3, 1), np.tile([[0.9, 0.15, 0.1]], (60, 1)), np.tile([[0.1, 0.2, 0.8]], (60, 1))]
    )
    labels = np.repeat([1, 2, 3], [144, 60, 60])
    return means, scales, colors, labels


def _make(folder: Path, views: int) -> tuple[Capture, Labelling]:
    means, scales, colors, labels = (torch.from_numpy(value).float() for value in _world())
    one_hot = torch.nn.functional.one_hot(labels.long(), 4)[:, 1:].float()
    quats = torch.tensor([1.0, 0, 0, 0]).repeat(len(means), 1)
    splats = Splats(means, quats, scales, torch.full((len(means),), 0.95), torch.cat([colors, one_hot], 1))
    camera = Camera(64, 48, 70.4, 70.4, 32, 24)
    capture_views, maps = [], []
    for index in range(views):
        angle = 2 * np.pi * index / views
        position = np.array([2.2 * np.cos(angle), 2.2 * np.sin(angle), 1.2 + 0.3 * (index % 2)])
        posed = PosedCamera(camera, look_at(position, np.array([0, 0, 0.15])), f"{index:03d}.png")
        viewmat = torch.from_numpy(posed.camera_from_world()).float()
        image = rasterize(splats, viewmat, camera).image
        path = folder / posed.name
        Image.fromarray((image[..., :3].clamp(0, 1) * 255).round().byte().numpy()).save(path)
        evidence = torch.cat([torch.full_like(image[..., :1], 0.5), image[..., 3:]], dim=2)
        maps.append(evidence.argmax(dim=2).numpy().astype(np.uint16))
        capture_views.append(View(posed, path))
    random = np.random.default_rng(0)
    rows = random.choice(len(means), min(150, len(means)), replace=False)
    points = means.numpy()[rows] + random.normal(0, 0.02, size=(len(rows), 3)).astype(np.float32)
    shades = (colors.numpy()[rows] * 255).round().astype(np.uint8)
    report = CaptureReport("images", views)
    capture = Capture(tuple(capture_views), points.astype(np.float32), shades, "ARBITRARY", report)
    return capture, Labelling(dictionary_of(LABELS), tuple(maps))


MakeWorld = Callable[..., tuple[Capture, Labelling]]


@pytest.fixture
def make_world(tmp_path: Path) -> MakeWorld:
    """`make_world(views)` renders the world's images afresh into a folder of the test."""
    return lambda views=12: _make(tmp_path, views)


@pytest.fixture(scope="session")
def world(tmp_path_factory: pytest.TempPathFactory) -> tuple[Capture, Labelling]:
    """The world in 12 views of 64×48; its files must not be changed."""
    return _make(tmp_path_factory.mktemp("world"), 12)


@pytest.fixture
def quick() -> Callable[..., TrainingSettings]:
    """Settings of a run of a few steps, bounded by iterations."""

    def make(**changes: Any) -> TrainingSettings:
        defaults: dict[str, Any] = {
            "iterations": 20,
            "time_budget_s": None,
            "max_gaussians": 250,
            "evaluations": 0,
            "tolerance_db": 0.0,
            "backend": "cpu",
        }
        return TrainingSettings(**(defaults | changes))

    return make


def drawn_parameters(count: int, degree: int = 1) -> dict[str, Tensor]:
    """Those of so many half-opaque Gaussians, by a fixed seed."""
    random = torch.Generator().manual_seed(0)
    return {
        "means": torch.randn(count, 3, generator=random),
        "quats": torch.randn(count, 4, generator=random),
        "log_scales": torch.full((count, 3), -3.0),
        "logit_opacities": torch.zeros(count),
        "sh_dc": torch.zeros(count, 1, 3),
        "sh_rest": torch.zeros(count, (degree + 1) ** 2 - 1, 3),
        "codes": torch.randn(count, 2, generator=random),
    }


def same_run(a: TrainedSplats, b: TrainedSplats) -> bool:
    """Whether two runs ended with the same bits."""
    pairs = [(getattr(a.gaussians, f.name), getattr(b.gaussians, f.name)) for f in dataclasses.fields(a.gaussians)]
    pairs += [(a.head.weight, b.head.weight), (a.head.bias, b.head.bias)]
    return all(x.shape == y.shape and (x == y).all() for x, y in pairs)


def masked(capture: Capture, index: int, mask: np.ndarray) -> Capture:
    """The capture whose view of this index is valid where the mask is not 0."""
    path = capture.views[index].image_path.parent / f"valid_{index}.png"
    Image.fromarray(mask.astype(np.uint8)).save(path)
    views = list(capture.views)
    views[index] = dataclasses.replace(views[index], valid_path=path)
    return dataclasses.replace(capture, views=tuple(views))


def repainted(capture: Capture, folder: Path, paint: Callable[[int, np.ndarray], np.ndarray]) -> Capture:
    """The capture with new photos in `folder`; `paint` makes each of its number and the old one, uint8 [H, W, 3]."""
    views = []
    for index, view in enumerate(capture.views):
        path = folder / view.posed.name
        Image.fromarray(paint(index, np.asarray(Image.open(view.image_path).convert("RGB")))).save(path)
        views.append(dataclasses.replace(view, image_path=path))
    return dataclasses.replace(capture, views=tuple(views))


def exposed(pixels: np.ndarray, correction: Tensor) -> np.ndarray:
    """The photo uint8 [H, W, 3] as one of that exposure and white balance [3], EV, shows it."""
    image = correct(torch.from_numpy(pixels.copy()).double() / 255, correction).clamp(0, 1)
    return (image * 255).round().byte().numpy()


def stopping_at(iteration: int) -> Callable[[ProgressEvent], None]:
    """A listener that cancels the run at this iteration."""

    def stop(event: ProgressEvent) -> None:
        if event.metrics.get("iteration", 0) >= iteration:
            raise CancelledError("stop")

    return stop


def assert_gradients_agree(
    backend: str, seed: int, features: Callable[[Tensor, Tensor], Tensor], loss: Callable[[Rendering], Tensor]
) -> None:
    """Of a loss of a rendering of 24×20 pixels: those of the backend are those of the reference in float64."""
    random = torch.Generator().manual_seed(seed)
    count, camera, viewmat = 40, Camera(24, 20, 22.0, 22.0, 12.0, 10.0), torch.eye(4)
    viewmat[2, 3] = 2.5
    values = (
        torch.rand(count, 3, generator=random) - 0.5,
        torch.randn(count, 4, generator=random),
        0.05 + 0.2 * torch.rand(count, 3, generator=random),
        0.2 + 0.6 * torch.rand(count, generator=random),
    )

    def gradients(name: str, dtype: torch.dtype) -> list[Tensor]:
        leaves = [value.to(dtype).requires_grad_() for value in values]
        pose = viewmat.to(dtype)
        loss(rasterize(Splats(*leaves, features(leaves[0], pose)), pose, camera, backend=name)).backward()
        return [leaf.grad.double() for leaf in leaves if leaf.grad is not None]

    exact = gradients("reference", torch.float64)
    assert len(exact) == 4
    for ours, theirs in zip(gradients(backend, torch.float32), exact, strict=True):
        assert float((ours - theirs).norm()) <= 2e-3 * float(theirs.norm())
