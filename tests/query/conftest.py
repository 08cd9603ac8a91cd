"""A text encoder one can reason about, and scenes whose answers are known."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.perception.lexicon.wordnet import Lexicon
from fastsplat.service.query.language.meaning import calibration
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.scenes import EMBEDDING_SIZE, labelled_scene


@pytest.fixture(scope="session")
def lexicon(wordnet_dir: Path) -> Iterator[Lexicon]:
    opened = Lexicon(wordnet_dir)
    yield opened
    opened.close()


class DrawnEncoder:
    """Words get directions drawn from their hash, or the ones a test chooses; `seen` holds what was not cached."""

    name = "drawn"
    sha256 = "0" * 64

    def __init__(self, directions: Mapping[str, Sequence[float]] | None = None) -> None:
        self._directions = dict(directions or {})
        self.seen: list[str] = []

    def encode(self, texts: Sequence[str]) -> np.ndarray:
        self.seen += texts
        vectors = np.stack([self._vector(text) for text in texts])
        return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)

    def _vector(self, text: str) -> np.ndarray:
        if text in self._directions:
            return np.pad(
                np.asarray(self._directions[text], dtype=float), (0, EMBEDDING_SIZE - len(self._directions[text]))
            )
        seed = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")
        return np.random.default_rng(seed).standard_normal(EMBEDDING_SIZE)


@pytest.fixture
def calibrated_encoder() -> DrawnEncoder:
    return calibrated()


def calibrated() -> DrawnEncoder:
    """Stands in for an encoder whose scores were measured: it has that one's name and hash."""
    encoder = DrawnEncoder()
    (key,) = json.loads(calibration.FILE.read_text())
    encoder.name, encoder.sha256 = key.split("@")[0], key.split("@")[1].ljust(64, "0")
    return encoder


PLAIN = QuerySettings(templates=("{}",), threshold=0.5, exact_threshold=0.95, backend="reference")
"""Bare names, known thresholds, the rasterizer that is its own oracle."""


def make_scene(labels: Sequence[str] = ("mug", "spoon", "bed"), per_label: int = 1, code: int | None = None) -> Scene:
    """A row of opaque balls along x, ball i of label i, codes one-hot; with `code`, their length, by evidence."""
    classes = len(labels) + 1
    size = classes if code is None else code
    count = classes * per_label
    ids = np.arange(count) // per_label
    rng = np.random.default_rng(0)
    means = np.zeros((count, 3), dtype=np.float32)
    means[:, 0] = ids - (classes - 1) / 2
    means += rng.normal(0, 0.01, means.shape).astype(np.float32)
    sh = rng.uniform(-1, 1, (count, 1, 3))
    evidence = evidence_of(np.arange(count), ids, np.full(count, 4 * UNIT), count)
    semantics = {} if code is None else {"evidence": evidence}
    return labelled_scene(means, ids, labels, scales=0.15, sh=sh, code_size=size, **semantics)


@pytest.fixture
def front() -> PosedCamera:
    """Looks along +z at the row of balls from 4 units away; 64×48 pixels."""
    pose = np.eye(4)
    pose[2, 3] = -4.0
    return PosedCamera(Camera(64, 48, 50.0, 50.0, 32.0, 24.0), pose)


@pytest.fixture
def away() -> PosedCamera:
    """Stands at the same place and looks the other way: sees nothing."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = -4.0
    return PosedCamera(Camera(64, 48, 50.0, 50.0, 32.0, 24.0), pose)


def index_of(scene: Scene) -> SceneIndex:
    """The scene, ready for questions as a service asks them."""
    return SceneIndex(scene, DrawnEncoder(), QuerySettings(backend="cpu"))


def plain_index_of(scene: Scene) -> SceneIndex:
    """The scene with the settings `PLAIN`."""
    return SceneIndex(scene, DrawnEncoder(), PLAIN)


def opened(scene: Scene) -> SceneIndex:
    """The scene, ready for questions that little but names answers."""
    settings = QuerySettings(templates=("{}",), threshold=0.9, exact_threshold=0.99, backend="cpu")
    return SceneIndex(scene, DrawnEncoder(), settings)
