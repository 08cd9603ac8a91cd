"""Small scenes of every shape."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.scene.artefact.scene import Evidence, Gaussians, Scene, SemanticHead
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.scene.objects.label_evidence import evidence_of
from fastsplat_contract.geometry.camera import Camera, PosedCamera


def some_evidence(count: int, labels: int, seed: int = 0) -> Evidence:
    """Drawn: about half of all Gaussians and labels, counts of up to ten pixels."""
    rng = np.random.default_rng(seed)
    rows, names = np.nonzero(rng.random((count, labels + 1)) < 0.5)
    return evidence_of(rows, names, rng.integers(1, 40_960, len(rows)), count)


def change_body(folder: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Changes `scene.json` and its digest."""
    body = json.loads((folder / "scene.json").read_text())
    change(body)
    body.pop("sha256", None)
    digest = hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()
    (folder / "scene.json").write_text(json.dumps(body | {"sha256": digest}))


def assert_same_gaussians(first: Gaussians, second: Gaussians) -> None:
    """To the bit, so that a zero keeps its sign."""
    for field in fields(Gaussians):
        a, b = (np.ascontiguousarray(getattr(gaussians, field.name)) for gaussians in (first, second))
        np.testing.assert_array_equal(a.view(np.uint32), b.view(np.uint32))


def read_back(scene: Scene, folder: Path) -> Scene:
    """What a scene is once it was written to a folder."""
    write_scene(scene, folder)
    return read_scene(folder)


def make_gaussians(count: int = 50, sh: int = 16, code: int = 3, seed: int = 0) -> Gaussians:
    rng = np.random.default_rng(seed)

    def draw(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape).astype(np.float32)

    return Gaussians(draw(count, 3), draw(count, 4), draw(count, 3), draw(count), draw(count, sh, 3), draw(count, code))


def make_scene(
    count: int = 50,
    labels: tuple[str, ...] = ("mug", "茶壶", "🧸"),
    sh: int = 16,
    code: int = 3,
    evidence: bool = False,
) -> Scene:
    rng = np.random.default_rng(1)
    entries = tuple(
        DictionaryEntry(label, (f"{label} alias",), 7 * i, i, 1 / (1 + i)) for i, label in enumerate(labels)
    )
    embeddings = rng.standard_normal((len(labels), 8)).astype(np.float32)
    pose = np.eye(4)
    pose[:3, 3] = [0.1, 1 / 3, -2e-17]
    return Scene(
        gaussians=make_gaussians(count, sh, code),
        head=SemanticHead(
            rng.standard_normal((len(labels) + 1, code)).astype(np.float32),
            rng.standard_normal(len(labels) + 1).astype(np.float32),
        ),
        dictionary=Dictionary(entries),
        label_embeddings=embeddings,
        text_encoder=("some_encoder", "ab" * 32),
        cameras=(PosedCamera(Camera(640, 480, 500.1, 500.2, 320.0, 240.0), pose, "a/é.jpg"),),
        scale="METRIC",
        training={"seed": 3, "nested": {"list": [1, 2.5, "x", None]}},
        quality={"psnr": 30.123456789},
        label_templates=("{}", "a {}"),
        evidence=some_evidence(count, len(labels)) if evidence else None,
    )
