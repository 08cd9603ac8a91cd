"""A wall of flat Gaussians, one half red and one green, at a known distance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.surfaces.surface_views import SurfaceView
from fastsplat.service.scene.artefact.scene import SH_C0
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.query.conftest import DrawnEncoder
from tests.scenes import labelled_scene

DISTANCE = 2.0
LABELS = ("red half", "grün\nhalf")
_CAMERA = Camera(64, 48, 60.0, 60.0, 32.0, 24.0)


def wall_index(settings: QuerySettings | None = None, cameras: Sequence[PosedCamera] | None = None) -> SceneIndex:
    """The plane z = `DISTANCE` from (−1, −0.7) to (1, 0.7), seen by four cameras that look along z."""
    x, y = np.meshgrid(np.arange(-1, 1, 0.05) + 0.025, np.arange(-0.7, 0.7, 0.05) + 0.025)
    means = np.stack([x.ravel(), y.ravel(), np.full(x.size, DISTANCE)], axis=1)
    ids = np.where(means[:, 0] < 0, 1, 2)
    colors = np.where(ids[:, None] == 1, [0.8, 0.1, 0.1], [0.1, 0.8, 0.1])
    if cameras is None:
        cameras = [_camera(number, offset) for number, offset in enumerate((-0.3, -0.1, 0.1, 0.3))]
    scene = labelled_scene(
        means,
        ids,
        LABELS,
        scales=np.tile([0.04, 0.04, 0.001], (len(means), 1)),
        sh=((colors - 0.5) / SH_C0)[:, None, :],
        cameras=cameras,
    )
    return SceneIndex(scene, DrawnEncoder(), settings or QuerySettings())


def _camera(number: int, offset: float) -> PosedCamera:
    pose = np.eye(4)
    pose[:2, 3] = offset, offset / 2
    return PosedCamera(_CAMERA, pose, f"{number}.png")


def picture_of(depth: np.ndarray) -> SurfaceView:
    """What a camera at the origin that looks along z shows, by its depth [H, W]; fx = fy = W."""
    height, width = depth.shape
    camera = Camera(width, height, float(width), float(width), width / 2, height / 2)
    shape = (height, width)
    return SurfaceView(
        posed=PosedCamera(camera, np.eye(4), "a.png"),
        depth=depth.astype(np.float32),
        normals=np.broadcast_to(np.array([0, 0, -1], np.float16), (*shape, 3)),
        confidence=np.ones(shape, np.float16),
        colors=np.zeros((*shape, 3), np.uint8),
        objects=np.zeros(shape, np.uint16),
        labels=np.zeros(shape, np.uint16),
    )
