"""The GPU benchmark: refuses where it could only guess, and measures with everything but gsplat's kernels."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import torch

from benchmarks.raster import gpu
from benchmarks.raster.garden import Scene
from tests.splatting.raster.raster_scenes import crowded


def test_without_a_gpu_nothing_is_measured_or_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr("benchmarks.provenance.RESULTS", tmp_path)
    monkeypatch.setattr("sys.argv", ["gpu"])
    with pytest.raises(SystemExit, match="NVIDIA GPU"):
        gpu.main()
    assert not list(tmp_path.iterdir())


def test_every_measurement_runs_up_to_the_kernels(gsplat_on_cpu: Any) -> None:
    view = crowded(0, count=40, channels=6)
    view = view.with_splats(opacities=view.splats.opacities.clamp(max=0.95))
    scene = Scene(view.splats, view.viewmat, view.camera)
    parity = gpu.compare(scene, torch.device("cpu"))
    assert set(parity) >= {"image", "alpha", "depth", "d_means", "d_quats", "d_scales", "d_opacities", "d_features"}
    assert max(parity.values()) < 1e-4
    assert math.isfinite(gpu.joint_step(scene, 2).ms)
    actions = {"rgb": gpu.rgb_step(scene), "picture": gpu.picture_of(scene)}
    for what, action in actions.items():
        assert gpu.timed(what, scene, action, 1).ms > 0
