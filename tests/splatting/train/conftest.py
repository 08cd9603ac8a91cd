"""A tiny world of known Gaussians: a chequered floor, a red ball, a blue block, seen by a ring of cameras."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from fastsplat.service.capture.types import Capture, CaptureReport, View
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.perception.types import Labelling
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat.service.splatting.raster.types import Splats
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat_contract.camera import Camera, PosedCamera
from fastsplat_contract.poses import look_at

LABELS = ("floor", "ball", "block")


def _world() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """means, scales, colours, labels."""
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


def _make(folder: Path, views: int, width: int = 64, height: int = 48) -> tuple[Capture, Labelling]:
    means, scales, colors, labels = (torch.from_numpy(value).float() for value in _world())
    one_hot = torch.nn.functional.one_hot(labels.long(), 4)[:, 1:].float()
    quats = torch.tensor([1.0, 0, 0, 0]).repeat(len(means), 1)
    splats = Splats(means, quats, scales, torch.full((len(means),), 0.95), torch.cat([colors, one_hot], 1))
    camera = Camera(width, height, 1.1 * width, 1.1 * width, width / 2, height / 2)
    made, maps = [], []
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
        made.append(View(posed, path))
    random = np.random.default_rng(0)
    rows = random.choice(len(means), 150, replace=False)
    points = means.numpy()[rows] + random.normal(0, 0.02, size=(150, 3)).astype(np.float32)
    shades = (colors.numpy()[rows] * 255).round().astype(np.uint8)
    report = CaptureReport("images", views)
    capture = Capture(tuple(made), points.astype(np.float32), shades, "ARBITRARY", report)
    return capture, Labelling(dictionary_of(LABELS), tuple(maps))


MakeWorld = Callable[..., tuple[Capture, Labelling]]


@pytest.fixture
def make_world(tmp_path: Path) -> MakeWorld:
    """`make_world(views, width, height)` renders a world's images afresh into a folder of the test."""

    def make(views: int = 12, **size: int) -> tuple[Capture, Labelling]:
        return _make(tmp_path, views, **size)

    return make


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
            "backend": "cpu",
        }
        return TrainingSettings(**(defaults | changes))

    return make
