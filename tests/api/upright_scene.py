"""A small scene whose z axis is up: the made scene of the other tests has y down."""

from __future__ import annotations

from dataclasses import replace

from fastsplat.service.application.service import SceneService
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.settings import Settings
from tests.api.made_scene import ENCODER, made_scene
from tests.query.box_scenes import BoxShell, orbit, scene_of
from tests.scenes import store_scene


def add_upright_scene(service: SceneService, settings: Settings, floor: str = "floor") -> str:
    """Stores a box (object 1, a mug) on a floor of that name (object 2), in meters; returns the scene's id."""
    shells = [
        BoxShell("mug", (0, 0, 0.2), (0.4, 0.4, 0.4), count=1_500),
        BoxShell(floor, (0, 0, -0.02), (3.0, 3.0, 0.02), count=6_000),
    ]
    words = made_scene(open_text_encoder(ENCODER, settings.models))
    scene = replace(
        scene_of(shells, orbit(8, 1.6, 1.2)),
        text_encoder=words.text_encoder,
        label_embeddings=words.label_embeddings[:2],
        label_templates=words.label_templates,
    )
    return store_scene(service._store, scene, "upright")
