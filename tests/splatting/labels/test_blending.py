"""Labels by evidence: they are those of one whole image with a channel a label."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from fastsplat.service.scene.artefact.scene import Evidence
from fastsplat.service.scene.objects.label_evidence import evidence_of, posterior
from fastsplat.service.splatting.labels.blending import EvidenceBlend
from fastsplat.service.splatting.raster.image_formation import LabelMap, Splats
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat_contract.geometry.camera import Camera

CPU = torch.device("cpu")


def crowd(count: int, channels: int) -> Splats:
    g = torch.Generator().manual_seed(0)
    means = torch.randn(count, 3, generator=g)
    means[:, 2] += 4.0
    return Splats(
        means,
        torch.randn(count, 4, generator=g),
        torch.exp(torch.randn(count, 3, generator=g) - 1.5),
        torch.rand(count, generator=g) ** 0.3,
        torch.rand(count, channels, generator=g),
    )


def drawn_evidence(count: int, classes: int) -> Evidence:
    rng = np.random.default_rng(classes)
    rows = np.repeat(np.arange(count), 3)
    return evidence_of(rows, rng.integers(0, classes, len(rows)), rng.integers(1, 40_000, len(rows)), count)


def whole(
    evidence: Evidence, classes: int, splats: Splats, viewmat: torch.Tensor, camera: Camera, relevancy: np.ndarray
) -> tuple[torch.Tensor, torch.Tensor]:
    """The oracle: classes [H, W] where alpha is at least 0.5, and expected relevancy, by one image of all labels."""
    found = posterior(evidence, classes)
    rows = np.repeat(np.arange(len(evidence)), np.diff(evidence.starts))
    table = np.zeros((len(evidence), classes), np.float32)
    table[rows, evidence.labels] = found.probability - found.rest[rows]
    features = torch.from_numpy(np.concatenate([table, (table @ relevancy)[:, None]], axis=1).astype(np.float32))
    drawn = rasterize(replace(splats, features=features), viewmat, camera)
    best = drawn.image[..., :-1].argmax(dim=2)
    visible = drawn.image[..., :-1].amax(dim=2) > 0
    return torch.where(visible & (drawn.alpha >= 0.5), best, 0), drawn.image[..., -1]


@pytest.mark.parametrize("classes", [2, 20, 90])
@pytest.mark.parametrize("channels", [0, 3])
def test_labels_are_those_of_the_whole_image(classes: int, channels: int) -> None:
    splats, camera, viewmat = crowd(200, channels), Camera(75, 61, 60.0, 60.0, 37.0, 30.0), torch.eye(4)
    evidence, relevancy = drawn_evidence(200, classes), np.linspace(0, 1, classes).astype(np.float32)
    truth, expected = whole(evidence, classes, splats, viewmat, camera, relevancy)
    blend = EvidenceBlend(evidence, classes, CPU)

    def render(scores: np.ndarray | None) -> LabelMap:
        return blend.render(splats, viewmat, camera, alpha_min=0.5, relevancy=scores, backend="cpu")

    labels, plain = render(relevancy), render(None)
    assert torch.equal(labels.classes, truth.to(torch.int32)) and torch.equal(labels.classes, plain.classes)
    assert labels.relevancy is not None and torch.allclose(labels.relevancy, expected, atol=1e-6)
    assert plain.relevancy is None
    picture = rasterize(splats, viewmat, camera)
    assert torch.equal(labels.image, picture.image) and torch.equal(labels.alpha, picture.alpha)
    assert torch.equal(plain.alpha, picture.alpha)


_PEAK = """
import resource, sys
import numpy as np, torch
sys.path.insert(0, {folder!r})
from test_blending import CPU, crowd, drawn_evidence
from fastsplat_contract.geometry.camera import Camera
from fastsplat.service.splatting.labels.blending import EvidenceBlend
blend, splats = EvidenceBlend(drawn_evidence(300, 32), 32, CPU), crowd(300, 3)
def render(side):
    camera = Camera(side, side, side / 2, side / 2, side / 2, side / 2)
    blend.render(splats, torch.eye(4), camera, alpha_min=0.5, relevancy=np.ones(32, np.float32), backend="cpu")
render(64)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
render(2048)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="memory is counted in kilobytes on Linux only")
def test_memory_of_a_large_view_is_that_of_its_result() -> None:
    folder = str(__file__).rpartition("/")[0]
    run = subprocess.run(
        [sys.executable, "-c", _PEAK.format(folder=folder)], capture_output=True, text=True, check=True
    )
    pixels = 2048 * 2048
    image_of_all_labels = pixels * (3 + 1 + 32) * 4
    assert int(run.stdout) < 0.6 * image_of_all_labels
    assert int(run.stdout) < 80 * pixels
