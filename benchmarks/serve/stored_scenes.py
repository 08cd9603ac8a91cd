"""Scenes of any size put into a store as finished jobs would leave them."""

from __future__ import annotations

import os
import uuid
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.language.meaning.embeddings import embed_labels
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.scene.artefact.scene import Gaussians, Scene, SemanticHead
from fastsplat.service.scene.artefact.scene_files import write_scene
from fastsplat.service.scene.formats.ply import write_ply
from fastsplat.service.store.rows.codec import camera_to_json
from fastsplat.service.store.rows.records import NewJob, SceneSummary
from fastsplat.service.store.store import Store
from fastsplat_contract.geometry.camera import Camera, PosedCamera

ENCODER = "minilm_l6_int8"
LABELS = tuple(
    "apple,bottle,book,bowl,chair,clock,coffee machine,cup,dining table,donut,fork,kettle,knife,lamp,plant,"
    "sofa,spoon,teddy bear,toaster,vase".split(",")
)
_CAMERA = Camera(width=640, height=480, fx=500.0, fy=500.0, cx=320.0, cy=240.0)


def room(gaussians: int, models: Path, seed: int = 0) -> Scene:
    """A room full of blobs, a Gaussian each at a random place of its label's blob, seen by four cameras."""
    rng = np.random.default_rng(seed)
    encoder = open_text_encoder(ENCODER, models)
    centres = rng.uniform([-2, -1, 3], [2, 1, 6], size=(len(LABELS), 3))
    label = rng.integers(0, len(LABELS), size=gaussians)
    size = 0.6 * gaussians ** (-1 / 3)
    directions = rng.normal(size=(len(LABELS) + 1, 8))
    codes = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    dictionary = Dictionary(tuple(DictionaryEntry(name, pixels=1000, views=4) for name in LABELS))
    poses = [np.eye(4) for _ in range(4)]
    for number, pose in enumerate(poses):
        pose[0, 3] = 0.2 * number
    return Scene(
        gaussians=Gaussians(
            means=(centres[label] + 0.25 * rng.normal(size=(gaussians, 3))).astype(np.float32),
            quats=rng.normal(size=(gaussians, 4)).astype(np.float32),
            log_scales=np.log(size * rng.uniform(0.3, 1.0, size=(gaussians, 3))).astype(np.float32),
            logit_opacities=rng.normal(1.0, 2.0, size=gaussians).astype(np.float32),
            sh=rng.normal(scale=0.5, size=(gaussians, 4, 3)).astype(np.float32),
            codes=codes[label + 1].astype(np.float32),
        ),
        head=SemanticHead((6 * codes).astype(np.float32), np.zeros(len(codes), np.float32)),
        dictionary=dictionary,
        label_embeddings=embed_labels(dictionary, encoder, QuerySettings().templates),
        label_templates=QuerySettings().templates,
        text_encoder=(encoder.name, encoder.sha256),
        cameras=tuple(PosedCamera(_CAMERA, pose, f"{number}.jpg") for number, pose in enumerate(poses)),
        scale="METRIC",
    )


def seen_around(scene: Scene, cameras: int = 24) -> Scene:
    """The room with cameras on a circle around its middle, so that whoever orbits has all of it before them."""
    middle = np.median(scene.gaussians.means, axis=0).astype(float)
    posed = []
    for number, angle in enumerate(np.linspace(0, 2 * np.pi, cameras, endpoint=False)):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec([0, angle, 0]).as_matrix()
        pose[:3, 3] = middle - 5 * pose[:3, 2]
        posed.append(PosedCamera(_CAMERA, pose, f"{number:03}.jpg"))
    return replace(scene, cameras=tuple(posed))


def add_scene(store: Store, scene: Scene, like: str = "") -> str:
    """Store a scene and return its id. With `like`, hard links to that scene's files stand in for files of its own."""
    scene_id, operation_id = uuid.uuid4().hex, uuid.uuid4().hex
    options: dict[str, object] = {"labels": [], "time_budget_s": None, "max_gaussians": None}
    store.scenes.create(NewJob(scene_id, operation_id, "room", "", "", uuid.uuid4().hex, options))
    if like:
        _link_tree(store.blobs.version(like, "1"), store.blobs.version(scene_id, "1"))
    else:
        folder = store.blobs.job(operation_id)
        write_scene(scene, folder / "artefact")
        write_ply(scene.gaussians, folder / "scene.ply")
        store.blobs.publish(folder, scene_id, "1")
    claim = store.jobs.claim(operation_id)
    assert claim is not None
    rows = [
        {"label_id": n, "label": e.label, "aliases": [], "pixels": e.pixels, "views": e.views, "gaussian_count": 1}
        for n, e in enumerate(scene.dictionary.entries, start=1)
    ]
    cameras = [camera_to_json(posed) for posed in scene.cameras]
    store.jobs.succeed(claim, SceneSummary("1", len(scene.gaussians), scene.scale, rows, cameras, {}, 0))
    return scene_id


def _link_tree(source: Path, target: Path) -> None:
    for folder, _, files in os.walk(source):
        there = target / Path(folder).relative_to(source)
        there.mkdir(parents=True)
        for name in files:
            os.link(Path(folder) / name, there / name)
