"""The table top as a splat made of its photos and depth maps, without a training: a Gaussian for every few pixels."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from fastsplat.service.instances.naming.name_models import NameModel, save_name_model
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.scene.artefact.scene import SH_C0, Object, Objects, Scene, SceneFacts
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.scenes import labelled_scene

SURFACES = ("table", "floor", "wall")
_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_DEPTH_UNIT = 1e-4
_VOXEL = 0.003
_SURE_PX = 16


def made_table(folder: Path, frames: Sequence[int], encoder: TextEncoder) -> tuple[Scene, dict[int, str]]:
    """The scene, in which nothing has a name, and what each of its objects is, by id."""
    document = json.loads((folder / "transforms.json").read_text())
    width, height = document["w"], document["h"]
    camera = Camera(width, height, document["fl_x"], document["fl_y"], document["cx"], document["cy"])
    rows, columns = np.mgrid[0:height:2, 0:width:2]
    rays = np.stack([(columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy], axis=-1)
    parts, cameras = [], []
    for frame in (document["frames"][number] for number in frames):
        pose = np.array(frame["transform_matrix"]) @ _OPENGL_FROM_OPENCV
        cameras.append(PosedCamera(camera, pose, Path(frame["file_path"]).name))
        depth = cv2.imread(str(folder / frame["depth_path"]), cv2.IMREAD_UNCHANGED)[rows, columns] * _DEPTH_UNIT
        points = np.concatenate([rays * depth[..., None], depth[..., None]], axis=-1)[depth > 0]
        colors = cv2.imread(str(folder / frame["file_path"]))[rows, columns, ::-1][depth > 0] / 255
        labels = cv2.imread(str(folder / frame["mask_path"]), cv2.IMREAD_UNCHANGED)[rows, columns][depth > 0]
        spacing = 2 * depth[depth > 0] / camera.fx
        parts.append(np.column_stack([points @ pose[:3, :3].T + pose[:3, 3], colors, spacing, labels]))
    table = np.concatenate(parts)
    table = table[np.isfinite(table).all(axis=1)]
    cells = np.column_stack([np.floor(table[:, :3] / _VOXEL), table[:, 7]]).astype(np.int64)
    _, cell, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    table = np.stack([np.bincount(cell.ravel(), column) for column in table.T], axis=1) / counts[:, None]
    labels = np.rint(table[:, 7]).astype(np.int64)
    objects = {number: name for name, number in document["labels"].items() if name not in SURFACES}
    owner = np.where(np.isin(labels, list(objects)), labels, 0)
    membership = evidence_of(np.arange(len(owner)), owner, np.full(len(owner), _SURE_PX * UNIT, np.int64), len(owner))
    scene = labelled_scene(
        table[:, :3],
        np.zeros(len(table), int),
        [],
        scales=np.repeat(0.7 * table[:, 6:7], 3, axis=1),
        logit_opacities=3.0,
        sh=((table[:, 3:6] - 0.5) / SH_C0)[:, None],
        encoder=encoder,
        cameras=cameras,
        objects=Objects(tuple(Object(number) for number in sorted(objects)), membership),
        facts=SceneFacts(searched_names=80, searched_for=tuple(f"name {number}" for number in range(80))),
    )
    return scene, objects


def measured_detector(models_dir: Path, models: Path, detector: str) -> Path:
    """The models, with a measurement by which a detector's evidence is about a probability."""
    for path in models_dir.glob("*/*"):
        (models / path.parent.name).mkdir(parents=True, exist_ok=True)
        (models / path.relative_to(models_dir)).symlink_to(path)
    save_name_model(NameModel(detector=detector, sets=(), factor=1, offset=0.6, categories={}), models)
    return models
