"""A job's time budget: decided once, whoever runs the job, and told to the user."""

from __future__ import annotations

import dataclasses
import json
import time
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.capture.types import Capture, CaptureReport, View
from fastsplat.service.common.progress import silent
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.plan import Speed
from fastsplat.service.splatting.presets import PERCEPTION_PRESETS, PRESETS
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.workers.budget import kept_plan, plan_perception, plan_training
from fastsplat.workers.protocol import Job
from fastsplat_contract.camera import Camera, PosedCamera
from fastsplat_contract.operations import SceneOptions


@pytest.fixture(autouse=True)
def _the_reference_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """How busy the machine is while tests run must not decide what they see."""
    monkeypatch.setattr("fastsplat.workers.budget.machine_speed", lambda backend: Speed())


def _job(folder: Path, options: SceneOptions, attempt: int = 1, perception_s: float = 2.0) -> Job:
    (folder / "perception").mkdir(parents=True, exist_ok=True)
    (folder / "perception" / "stage.json").write_text(json.dumps({"seconds": perception_s, "attempt": attempt}))
    return Job("operation", attempt, folder, folder, options, Settings())


def _capture(views: int) -> Capture:
    camera = Camera(480, 360, 500.0, 500.0, 240.0, 180.0)
    posed = [View(PosedCamera(camera, np.eye(4), f"{i}.jpg"), Path(f"{i}.jpg")) for i in range(views)]
    points = np.zeros((5_000, 3), np.float32)
    return Capture(tuple(posed), points, points.astype(np.uint8), "METRIC", CaptureReport("nerfstudio", views))


def test_without_a_budget_a_job_trains_with_the_operators_settings_and_the_users_choices(tmp_path: Path) -> None:
    plain = plan_training(_job(tmp_path, SceneOptions()), _capture(20), 5, time.monotonic())
    assert (plain.settings, plain.given_up) == (TrainingSettings(), ())
    fewer = plan_training(_job(tmp_path, SceneOptions(max_gaussians=77, preset="best")), _capture(20), 5, 0.0)
    assert fewer.settings == TrainingSettings().model_copy(update={**PRESETS["best"], "max_gaussians": 77})
    settings, given_up = plan_perception(
        _job(tmp_path, SceneOptions(preset="draft")), _capture(20), time.monotonic(), silent
    )
    assert given_up == () and settings.max_views == PERCEPTION_PRESETS["draft"]["max_views"]


def test_a_budget_is_planned_once_and_a_later_attempt_trains_with_the_same(tmp_path: Path) -> None:
    options = SceneOptions(time_budget_s=20.0)
    job = _job(tmp_path, options)
    first = plan_training(job, _capture(40), 17, time.monotonic())
    assert first.settings.time_budget_s is not None and 5 < first.settings.time_budget_s < 18
    assert any("optimisation" in line for line in first.given_up)
    later = _job(tmp_path, options, attempt=2, perception_s=9.0)
    assert plan_training(later, _capture(40), 17, time.monotonic()) == first == kept_plan(later)
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["plan.json"]


def test_what_perception_took_is_missing_from_the_training(tmp_path: Path) -> None:
    found = [
        plan_training(
            _job(tmp_path / str(spent), SceneOptions(time_budget_s=60.0), perception_s=spent),
            _capture(40),
            17,
            time.monotonic(),
        ).settings.time_budget_s
        for spent in (1.0, 30.0)
    ]
    assert found[0] is not None and found[1] is not None
    assert found[0] - found[1] == pytest.approx(29, abs=2)


def test_a_budget_that_perception_has_used_up_still_trains_and_says_so(tmp_path: Path) -> None:
    job = _job(tmp_path, SceneOptions(time_budget_s=1.0), perception_s=10.0)
    found = plan_training(job, _capture(40), 17, time.monotonic())
    assert found.settings.time_budget_s == pytest.approx(0.1)
    assert "the time budget itself: 1 s" in found.given_up[-1]


def test_given_label_maps_and_few_views_need_no_trial_of_perception(tmp_path: Path) -> None:
    job = _job(tmp_path, SceneOptions(time_budget_s=5.0))
    settings, given_up = plan_perception(job, _capture(3), time.monotonic(), silent)
    assert settings == job.settings.perception and given_up == ()
    unposed = dataclasses.replace(job, options=SceneOptions())
    assert plan_perception(unposed, _capture(40), time.monotonic(), silent) == (job.settings.perception, ())
