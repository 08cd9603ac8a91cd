"""One trainer for all backends: the same code, the same picture, on whatever device the backend wants."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fastsplat.service.common.progress import silent
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat_contract.errors import CancelledError
from tests.splatting.gsplat_front_end import needs_gpu
from tests.splatting.training.conftest import stopping_at

_SHORT: dict[str, Any] = {
    "iterations": 24, "time_budget_s": None, "max_gaussians": 160, "evaluations": 0,
}  # fmt: skip


@pytest.fixture(params=["reference", "gsplat front end", pytest.param("GPU", marks=needs_gpu)])
def backend(request: pytest.FixtureRequest) -> str:
    """`gsplat front end` is backend `cuda` on the CPU with gsplat's front end, its kernels replaced."""
    if request.param == "gsplat front end":
        request.getfixturevalue("gsplat_on_cpu")
    return "reference" if request.param == "reference" else "cuda"


@pytest.fixture(scope="module")
def by_cpu(world) -> TrainedSplats:
    return train(*world, TrainingSettings(**_SHORT, backend="cpu"), silent)


def test_every_backend_learns_what_cpu_learns(world, by_cpu: TrainedSplats, backend: str) -> None:
    wanted, found = by_cpu, train(*world, TrainingSettings(**_SHORT, backend=backend), silent)
    assert found.quality["psnr"] == pytest.approx(wanted.quality["psnr"], abs=0.2)
    assert found.quality["loss"] == pytest.approx(wanted.quality["loss"], rel=0.02)
    assert len(found.gaussians) == pytest.approx(len(wanted.gaussians), abs=2)
    assert isinstance(found.gaussians.means, np.ndarray) and found.gaussians.codes.shape[1] > 0


def test_a_run_goes_on_from_its_checkpoint(world, quick, backend: str, tmp_path: Path) -> None:
    settings = quick(iterations=8, max_gaussians=120, backend=backend, checkpoint_every_s=0.0, evaluations=4)
    with pytest.raises(CancelledError):
        train(*world, settings, stopping_at(4), tmp_path)
    assert (tmp_path / "training.safetensors").exists()
    assert train(*world, settings, silent, tmp_path).quality["iterations"] == 8


def test_masked_pixels_and_scenes_without_labels_train(make_world, quick, backend: str) -> None:
    capture, labelling = make_world()
    found = train(capture, type(labelling)(labelling.dictionary, ()), quick(iterations=3, backend=backend), silent)
    assert found.gaussians.codes.shape[1] == 0
