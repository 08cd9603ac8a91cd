"""The made scene is as much work as garden, so that a benchmark without the data means something."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.raster.garden import Scene, garden, made_garden
from fastsplat.service.splatting.raster.rendering import rasterize


def _work(scene: Scene) -> dict[str, float]:
    out = rasterize(scene.splats, scene.viewmat, scene.camera)
    radii = out.radii[out.radii > 0].double().clamp_max(64)
    return {"visible": float(len(radii)), "covered": float((radii**2).sum()), "alpha": float(out.alpha.mean())}


@pytest.mark.parametrize(("count", "size"), [(20_000, (320, 240)), (100_000, (640, 480))])
def test_the_made_scene_has_the_statistics_of_garden(
    test_data: Path, monkeypatch: pytest.MonkeyPatch, count: int, size: tuple[int, int]
) -> None:
    monkeypatch.setenv("FASTSPLAT_TEST_DATA", str(test_data))
    real, made = garden(count, *size, 3), made_garden(count, *size, 3)
    assert (real.source, made.source) == ("garden", "made") and real.camera == made.camera
    expected, actual = _work(real), _work(made)
    for name, value in expected.items():
        assert actual[name] == pytest.approx(value, rel=0.2), name


def test_without_the_data_the_made_scene_is_measured_and_it_is_always_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FASTSPLAT_TEST_DATA", "/nowhere")
    first, second = (garden(5_000, 64, 48, 5) for _ in range(2))
    assert first.source == "made"
    for name in ("means", "quats", "scales", "opacities", "features"):
        left, right = getattr(first.splats, name), getattr(second.splats, name)
        assert len(left) == 5_000 and torch.equal(left, right) and np.isfinite(left.numpy()).all()
    assert first.splats.features.shape[1] == 5 and bool((first.splats.scales > 0).all())
