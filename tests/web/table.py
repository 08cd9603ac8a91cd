"""A small scene with solid objects on a table, for pictures that a browser draws."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.application.service import SceneService
from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.scene.artefact.scene import SH_C0, Scene
from fastsplat.service.settings import Settings
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.poses import look_at
from fastsplat_contract.photos.pictures import PictureRequest
from tests.api.made_scene import ENCODER, LABELS
from tests.scenes import add_photos, labelled_scene, store_scene

_CAMERA = Camera(width=320, height=240, fx=300.0, fy=300.0, cx=160.0, cy=120.0)
_PLACES = {"mug": (-0.7, 0.0, 0.3), "ball": (0.0, 0.3, 0.3), "story book": (0.7, -0.1, 0.3)}
_COLORS = {"mug": (0.8, 0.2, 0.2), "ball": (0.2, 0.7, 0.3), "story book": (0.2, 0.3, 0.8)}
_RADIUS = 0.3
_PER_OBJECT = 900
_TABLE = 2_400


def add_table(
    service: SceneService, settings: Settings, name: str = "a table", labels: tuple[str, ...] = LABELS
) -> str:
    """Stores the scene as a job that succeeded, its objects named `labels`; returns its id."""
    stage = {"stage": "training", "fraction": 1.0, "message": "done", "seconds": 12.5, "metrics": {"psnr": 31.5}}
    scene_id = store_scene(service._store, table(settings, labels), name, stages=[stage])
    cameras = service.get_scene(scene_id).cameras
    add_photos(service._store, scene_id, [_photo(service, scene_id, posed.name) for posed in cameras])
    return scene_id


def _photo(service: SceneService, scene_id: str, view: str) -> Image.Image:
    """What the scene shows from a camera with red and blue exchanged, so that photo and scene can be told apart."""
    with Image.open(io.BytesIO(service.answers.picture(PictureRequest(scene_id, "rgb", view=view)))) as picture:
        red, green, blue = picture.convert("RGB").split()
    return Image.merge("RGB", (blue, green, red))


def table(settings: Settings, labels: tuple[str, ...] = LABELS) -> Scene:
    """Three opaque balls on a gray disk; z is up; seen by cameras around it."""
    rng = np.random.default_rng(11)
    means, colors, ids = [_disk(rng)], [np.full((_TABLE, 3), 0.6)], [np.zeros(_TABLE, dtype=np.int64)]
    for label_id, label in enumerate(LABELS, start=1):
        directions = rng.normal(size=(_PER_OBJECT, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        means.append(np.array(_PLACES[label]) + _RADIUS * directions)
        colors.append(np.clip(np.array(_COLORS[label]) + rng.normal(scale=0.05, size=(_PER_OBJECT, 3)), 0, 1))
        ids.append(np.full(_PER_OBJECT, label_id))
    encoder = open_text_encoder(ENCODER, settings.models)
    return labelled_scene(
        np.concatenate(means),
        np.concatenate(ids),
        Dictionary(tuple(DictionaryEntry(label, pixels=100, views=3) for label in labels)),
        scales=0.035,
        logit_opacities=4.0,
        sh=((np.concatenate(colors) - 0.5) / SH_C0)[:, None, :],
        undetected_bias=2.0,
        encoder=encoder,
        templates=QuerySettings().templates,
        cameras=[_around(angle, f"{number:03}.jpg") for number, angle in enumerate((-1.6, -1.0, -2.2))],
        quality={"psnr": 31.5, "images": 3, "registered": 3, "next_doubling_db": 0.31},
    )


def looking(
    position: NDArray[np.float64],
    target: NDArray[np.float64],
    camera: Camera,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> PosedCamera:
    """A camera that looks from one point to another, `up` upright in its picture."""
    return PosedCamera(camera, look_at(position, target, up))


def _around(angle: float, name: str) -> PosedCamera:
    position = np.array([3.2 * np.cos(angle), 3.2 * np.sin(angle), 1.6])
    posed = looking(position, np.array([0.0, 0.0, 0.2]), _CAMERA)
    return PosedCamera(posed.camera, posed.world_from_camera, name)


def _disk(rng: np.random.Generator) -> NDArray[np.float64]:
    radius, angle = 1.4 * np.sqrt(rng.uniform(size=_TABLE)), rng.uniform(0, 2 * np.pi, size=_TABLE)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(_TABLE)], axis=1)
