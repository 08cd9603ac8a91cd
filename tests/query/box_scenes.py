"""Scenes of boxes whose places and sizes are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.scene.artefact.scene import Object, Objects, Scene, SemanticHead
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.poses import look_at
from tests.scenes import labelled_scene


@dataclass(frozen=True)
class BoxShell:
    """A cuboid's surface: edge lengths `size`, turned by `yaw` radians about z."""

    label: str
    centre: tuple[float, float, float]
    size: tuple[float, float, float] = (0.1, 0.06, 0.08)
    yaw: float = 0.0
    count: int = 300


def scene_of(objects: Sequence[BoxShell], cameras: Sequence[PosedCamera] = (), degree: int = 0) -> Scene:
    """Gaussians on the surfaces, as wide as they are apart, codes one-hot; meters."""
    labels = list(dict.fromkeys(obj.label for obj in objects))
    rng = np.random.default_rng(0)
    means = np.concatenate([_surface(obj, rng) for obj in objects])
    ids = np.concatenate([np.full(obj.count, labels.index(obj.label) + 1) for obj in objects])
    area = np.concatenate([np.full(obj.count, _area(obj) / obj.count) for obj in objects])
    count = len(means)
    sh = rng.normal(0, 0.15, (count, (degree + 1) ** 2, 3))
    sh[:, 0] += 0.5
    quats = rng.standard_normal((count, 4))
    scales = np.sqrt(area)[:, None] * np.exp(rng.normal(0, 0.2, (count, 3)))
    return labelled_scene(means, ids, labels, quats=quats, scales=scales, logit_opacities=3.0, sh=sh, cameras=cameras)


def with_objects(scene: Scene, owner: np.ndarray, objects: Sequence[Object], **changes: Any) -> Scene:
    """The scene without labels, but with objects, whose ids are those of `owner` [G]."""
    count = len(owner)
    membership = evidence_of(np.arange(count), owner, np.full(count, 50 * UNIT), count)
    return replace(
        scene,
        gaussians=replace(scene.gaussians, codes=np.zeros((count, 0), np.float32)),
        head=SemanticHead.unlearnt(0),
        dictionary=Dictionary(()),
        label_embeddings=np.zeros((0, scene.label_embeddings.shape[1]), np.float32),
        objects=Objects(tuple(objects), membership, **changes),
    )


def look(eye: Sequence[float], target: Sequence[float], name: str) -> PosedCamera:
    """A level camera (z is up) of 96×72 pixels."""
    return PosedCamera(Camera(96, 72, 90.0, 90.0, 48.0, 36.0), look_at(eye, target), name)


def orbit(count: int = 8, radius: float = 1.0, height: float = 0.5, middle: float = 0.0) -> list[PosedCamera]:
    """Level cameras around the vertical, which look at its point `middle`."""
    angles = np.arange(count) * 2 * np.pi / count
    eyes = [(radius * np.cos(angle), radius * np.sin(angle), height) for angle in angles]
    return [look(eye, (0, 0, middle), f"{number}.jpg") for number, eye in enumerate(eyes)]


def rigid(seed: int | np.random.Generator) -> np.ndarray:
    """Any rotation, and a translation of a few units."""
    rng = np.random.default_rng(seed)
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q *= np.sign(np.diag(r))
    pose = np.eye(4)
    pose[:3, :3] = q * np.linalg.det(q)
    pose[:3, 3] = rng.normal(0, 2, 3)
    return pose


def with_cameras_moved(scene: Scene, pose: np.ndarray) -> Scene:
    return replace(
        scene, cameras=tuple(replace(c, world_from_camera=pose @ c.world_from_camera) for c in scene.cameras)
    )


def _surface(obj: BoxShell, rng: np.random.Generator) -> np.ndarray:
    size = np.array(obj.size)
    faces = np.repeat([size[1] * size[2], size[0] * size[2], size[0] * size[1]], 2)
    face = rng.choice(6, obj.count, p=faces / faces.sum())
    points = rng.uniform(-0.5, 0.5, (obj.count, 3))
    points[np.arange(obj.count), face // 2] = face % 2 - 0.5
    points *= size
    c, s = np.cos(obj.yaw), np.sin(obj.yaw)
    return points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + obj.centre


def _area(obj: BoxShell) -> float:
    x, y, z = obj.size
    return 2 * (x * y + y * z + z * x)
