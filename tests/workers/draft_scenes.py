"""A place of three objects, as a draft knows it and as it is in the end."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.scene.artefact.scene import Object, Objects, Scene
from fastsplat.service.scene.objects.label_evidence import evidence_of
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.api.made_scene import ENCODER
from tests.scenes import labelled_scene

PLACES = (-1.0, 0.0, 1.0)  # x of the objects, left to right
DRAFT_IDS, FINAL_IDS = (2, 3, 1), (1, 2, 3)  # of the objects, in this order
ONLY_IN_DRAFT = 4


def of_objects(models: Path, *, draft: bool) -> Scene:
    """Balls of Gaussians, 12 an object in a draft, 40 in the end; a draft also has an object far behind them."""
    per_object, ids = (12, DRAFT_IDS) if draft else (40, FINAL_IDS)
    random = np.random.default_rng(1 if draft else 2)
    centers = [(x, 0.0, 4.0) for x in PLACES] + ([(0.0, 0.0, 9.0)] if draft else [])
    owner = np.repeat((*ids, ONLY_IN_DRAFT) if draft else ids, per_object)
    means = np.repeat(centers, per_object, axis=0) + 0.1 * random.normal(size=(len(owner), 3))
    looks = np.full(4, 0.5, np.float16).tobytes()
    table = tuple(Object(number, appearance=looks) for number in sorted(set(owner.tolist())))
    membership = evidence_of(np.arange(len(owner)), owner, np.full(len(owner), 4096), len(owner))
    return labelled_scene(
        means,
        np.zeros(len(owner), int),
        (),
        encoder=open_text_encoder(ENCODER, models),
        templates=QuerySettings().templates,
        cameras=[PosedCamera(Camera(48, 36, 40.0, 40.0, 24.0, 18.0), np.eye(4), "front.png")],
        objects=Objects(table, membership),
        scale="METRIC",
    )
