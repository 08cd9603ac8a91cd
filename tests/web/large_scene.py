"""A scene of many Gaussians."""

from __future__ import annotations

import numpy as np

from fastsplat.service.application.service import SceneService
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.scene.artefact.scene import SH_C0, Scene
from fastsplat.service.settings import Settings
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.api.made_scene import ENCODER, LABELS
from tests.scenes import labelled_scene, store_scene
from tests.web.table import looking


def large_scene(settings: Settings, count: int, degree: int = 3) -> Scene:
    """A room of `count` Gaussians: a floor, and balls on it, three of them with names; harmonics of `degree`."""
    rng = np.random.default_rng(5)
    balls = np.column_stack([rng.uniform(-4, 4, (40, 2)), np.full(40, 0.45)])
    floor = count // 3
    which = rng.integers(len(balls), size=count - floor)
    directions = rng.normal(size=(count - floor, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    means = np.concatenate([
        np.column_stack([rng.uniform(-5, 5, (floor, 2)), rng.normal(scale=0.01, size=floor)]),
        balls[which] + 0.45 * directions,
    ])  # fmt: skip
    colors = np.concatenate([np.full((floor, 3), 0.6), rng.uniform(0.1, 0.9, (len(balls), 3))[which]])
    sh = rng.normal(scale=0.05, size=(count, (degree + 1) ** 2, 3)).astype(np.float32)
    sh[:, 0] = (colors - 0.5) / SH_C0
    ids = np.concatenate([np.zeros(floor, np.int64), np.where(which < len(LABELS), which + 1, 0)])
    camera = Camera(640, 480, 600.0, 600.0, 320.0, 240.0)
    cameras = []
    for number, angle in enumerate(np.linspace(0, 2 * np.pi, 24, endpoint=False)):
        posed = looking(np.array([7 * np.cos(angle), 7 * np.sin(angle), 3.0]), np.array([0, 0, 0.3]), camera)
        cameras.append(PosedCamera(posed.camera, posed.world_from_camera, f"{number:03}.jpg"))
    return labelled_scene(
        means,
        ids,
        LABELS,
        scales=float(1.0 / np.sqrt(count / 100)),
        logit_opacities=3.0,
        sh=sh,
        undetected_bias=2.0,
        encoder=open_text_encoder(ENCODER, settings.models),
        cameras=cameras,
    )


def add_large_scene(service: SceneService, settings: Settings, count: int, degree: int = 3) -> str:
    """Stores the scene as a job that succeeded; returns its id."""
    return store_scene(service._store, large_scene(settings, count, degree), "large")
