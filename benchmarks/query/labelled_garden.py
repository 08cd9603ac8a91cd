"""Scenes to be asked: the rasterizer benchmark's garden, cut into labels by place."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from benchmarks.raster.garden import garden
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.perception.types import TextEncoder
from fastsplat.service.query.language.common_things import FILE
from fastsplat.service.query.language.embeddings import embed_labels
from fastsplat.service.query.settings import QuerySettings
from fastsplat.service.scene.label_evidence import evidence_from_dense
from fastsplat.service.scene.types import Gaussians, Scene, SemanticHead
from fastsplat_contract.camera import PosedCamera

CODE = 8
_VIEWS = 40


def labelled_garden(
    count: int, labels: int, encoder: TextEncoder, mode: str = "codes", width: int = 640, height: int = 480
) -> Scene:
    """`count` Gaussians; each has the label of the nearest of `labels` random places, a common thing's name, as a code
    of 8 numbers and as evidence; forty cameras around the garden's own, which is the first."""
    view = garden(count, width, height, 1)
    random = np.random.default_rng(0)
    means = view.splats.means.numpy()
    _, nearest = cKDTree(means[random.permutation(count)[:labels]]).query(means)
    ids = np.asarray(nearest, dtype=np.int64) + 1
    anchors = random.standard_normal((labels + 1, CODE)).astype(np.float32)
    sums = np.zeros((count, labels + 1), dtype=np.float32)
    sums[np.arange(count), ids] = 5.0
    names = common_names()
    dictionary = dictionary_of(names[place] for place in random.permutation(len(names))[:labels])
    pose = np.linalg.inv(view.viewmat.numpy().astype(np.float64))
    return Scene(
        gaussians=Gaussians(
            means=means,
            quats=view.splats.quats.numpy(),
            log_scales=np.log(view.splats.scales.numpy()),
            logit_opacities=torch.logit(view.splats.opacities).numpy(),
            sh=random.normal(0, 0.3, (count, 4, 3)).astype(np.float32),
            codes=anchors[ids] + random.normal(0, 0.1, (count, CODE)).astype(np.float32),
        ),
        head=SemanticHead(anchors, -0.5 * (anchors**2).sum(axis=1)),
        dictionary=dictionary,
        label_embeddings=embed_labels(dictionary, encoder),
        text_encoder=(encoder.name, encoder.sha256),
        cameras=tuple(
            PosedCamera(view.camera, _turned(pose, 2 * np.pi * i / _VIEWS), f"{i}.jpg") for i in range(_VIEWS)
        ),
        scale="ARBITRARY",
        label_templates=QuerySettings().templates,
        evidence=evidence_from_dense(sums) if mode == "evidence" else None,
    )


def common_names() -> list[str]:
    """Of common things, each once."""
    lines = FILE.read_text("ascii").splitlines()
    return [entry.label for entry in dictionary_of(line.split(" | ")[0] for line in lines).entries]


def _turned(pose: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    turn = np.eye(4)
    turn[:2, :2] = [[c, -s], [s, c]]
    return np.asarray(turn @ pose)
