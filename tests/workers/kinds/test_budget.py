"""A job's time budget is planned once, whichever attempt runs the job, and every tradeoff is reported."""

from __future__ import annotations

import dataclasses
import json
import time
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.capture.captures import Capture, CaptureReport, GivenLabels, View
from fastsplat.service.capture.formats.image_io import PhotoInfo
from fastsplat.service.capture.formats.upload_manifest import VALIDATED, UploadManifest, write_manifest
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import ProgressEvent, silent
from fastsplat.service.planning.cost_model import Speed
from fastsplat.service.planning.job_time import PhotoSet, job_seconds
from fastsplat.service.planning.presets import TOLERANCES_DB, apply_preset, chosen_settings, tolerance_changes
from fastsplat.service.planning.time_budget import plan_perception, with_tradeoffs
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.workers.job.protocol import Job
from fastsplat.workers.kinds.create_scene import job_time, make_plan, stored_plan
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.jobs.operations import SceneOptions


@pytest.fixture(autouse=True)
def _the_reference_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """How busy the machine is while tests run must not decide what they see."""
    monkeypatch.setattr("fastsplat.workers.kinds.create_scene.machine_speed", lambda backend: Speed())


def _job(folder: Path, options: SceneOptions, attempt: int = 1, perception_s: float = 2.0) -> Job:
    (folder / "perception").mkdir(parents=True, exist_ok=True)
    (folder / "perception" / "stage.json").write_text(json.dumps({"seconds": perception_s, "attempt": attempt}))
    (folder / VALIDATED).mkdir(exist_ok=True)
    photos = tuple(PhotoInfo(f"{number}.jpg", 4_000, 3_000, 1, "", 0.0) for number in range(26))
    write_manifest(UploadManifest("images", photos=photos), folder / VALIDATED)
    return Job("operation", attempt, folder, folder, options, chosen_settings(Settings(), options))


def _capture(views: int) -> Capture:
    camera = Camera(480, 360, 500.0, 500.0, 240.0, 180.0)
    posed = [View(PosedCamera(camera, np.eye(4), f"{i}.jpg"), Path(f"{i}.jpg")) for i in range(views)]
    points = np.zeros((5_000, 3), np.float32)
    return Capture(tuple(posed), points, points.astype(np.uint8), "METRIC", CaptureReport("nerfstudio", views))


def test_without_a_budget_a_job_trains_with_the_operators_settings_and_the_users_choices(tmp_path: Path) -> None:
    plain = make_plan(_job(tmp_path, SceneOptions()), _capture(20), 5, time.monotonic())
    assert (plain.settings, plain.tradeoffs) == (TrainingSettings(), ())
    fewer = make_plan(_job(tmp_path, SceneOptions(max_gaussians=77, preset="best")), _capture(20), 5, 0.0)
    assert fewer.settings == TrainingSettings().model_copy(
        update={**tolerance_changes(TOLERANCES_DB["best"]), "max_gaussians": 77}
    )
    assert _job(tmp_path, SceneOptions(preset="draft")).settings == apply_preset(Settings(), "draft")


def test_a_posted_lens_wins_over_the_operators() -> None:
    operators = Settings(capture={"lens": "panorama", "nadir_deg": 30.0})
    capture = chosen_settings(operators, SceneOptions(lens="fisheye")).capture
    assert (capture.lens, capture.nadir_deg) == ("fisheye", 30.0)


def test_a_budget_is_planned_once_and_a_later_attempt_trains_with_the_same(tmp_path: Path) -> None:
    options = SceneOptions(time_budget_s=40.0)
    job = _job(tmp_path, options)
    first = make_plan(job, _capture(40), 17, time.monotonic())
    assert first.settings.time_budget_s is not None and 5 < first.settings.time_budget_s < 38
    assert any("optimization" in line for line in first.tradeoffs)
    later = _job(tmp_path, options, attempt=2, perception_s=9.0)
    assert make_plan(later, _capture(40), 17, time.monotonic()) == first == stored_plan(later)
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_file()) == ["plan.json", "speed.json"]
    elsewhere = _job(tmp_path / "elsewhere", options)
    elsewhere.result("training").mkdir()
    (tmp_path / "plan.json").rename(elsewhere.result("training") / "plan.json")
    assert stored_plan(elsewhere) == first  # where the training is all that came


def test_the_speed_of_the_machine_is_measured_once_a_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measured: list[str] = []
    monkeypatch.setattr(
        "fastsplat.workers.kinds.create_scene.machine_speed", lambda backend: measured.append(backend) or Speed()
    )
    monkeypatch.setattr("fastsplat.service.planning.machine._mean", lambda work: pytest.fail("once more"))
    capture = _capture(40)
    for attempt in (1, 2):
        job = _job(tmp_path, SceneOptions(time_budget_s=20.0), attempt)
        make_plan(job, capture, 17, time.monotonic())
        job_time(job, capture, 17)
    assert measured == ["cpu"]


def test_what_photos_without_poses_take_is_known_when_their_job_begins_and_corrected_by_its_stages(
    tmp_path: Path,
) -> None:
    photos = PhotoSet(26, 4_000, 3_000)
    job = _job(tmp_path, SceneOptions())
    (tmp_path / "perception" / "stage.json").unlink()
    (tmp_path / "perception").rmdir()
    expected = job_seconds(photos, job.settings, Speed())
    known = job_time(job)
    assert (known.seconds(Speed()), known.ran, known.speed_now) == (expected, (), Speed())
    for stage in ("capture", "perception"):
        (tmp_path / stage).mkdir()
        (tmp_path / stage / "stage.json").write_text(json.dumps({"seconds": 4 * expected[stage], "attempt": 1}))
        later = job_time(job, _capture(26))
        assert later.ran[0] == pytest.approx((expected["capture"], 4 * expected["capture"], 1.0))
        assert known.speed.steps / 4 < later.speed_now.steps < known.speed_now.steps
        known = later
    write_manifest(UploadManifest("video", video="walk.mp4"), tmp_path / VALIDATED)
    assert job_time(job).seconds(Speed()) == {}


def test_what_perception_took_is_missing_from_the_training(tmp_path: Path) -> None:
    plans = [
        make_plan(
            _job(tmp_path / str(spent), SceneOptions(time_budget_s=60.0), perception_s=spent),
            _capture(40),
            17,
            time.monotonic(),
        ).settings.time_budget_s
        for spent in (1.0, 30.0)
    ]
    assert plans[0] is not None and plans[1] is not None
    assert plans[0] - plans[1] > 27


def test_a_budget_that_perception_has_used_up_still_trains_and_says_so(tmp_path: Path) -> None:
    job = _job(tmp_path, SceneOptions(time_budget_s=1.0), perception_s=10.0)
    plan = make_plan(job, _capture(40), 17, time.monotonic())
    assert plan.settings.time_budget_s == pytest.approx(0.1)
    assert "the time budget itself: 1 s" in plan.tradeoffs[-1]


@pytest.mark.parametrize(("views", "budget", "has_maps"), [(3, 5.0, False), (40, None, False), (40, 5.0, True)])
def test_few_views_label_maps_of_the_capture_and_no_budget_need_no_trial(
    views: int, budget: float | None, has_maps: bool
) -> None:
    capture = _capture(views)
    if has_maps:
        capture = dataclasses.replace(capture, given_labels=GivenLabels(Dictionary(()), (None,) * views))
    plan = plan_perception(capture, Settings(), (), budget, _no_progress, started=time.monotonic())
    assert plan.settings == Settings().perception and plan.tradeoffs == ()


def _no_progress(event: ProgressEvent) -> None:
    raise AssertionError(event)


def test_tradeoffs_end_every_message() -> None:
    events: list[ProgressEvent] = []
    with_tradeoffs(events.append, ("fewer views", "coarser"))(ProgressEvent("training", 0.5, "step 3"))
    assert [event.message for event in events] == ["step 3 (to end in time: fewer views, coarser)"]
    assert with_tradeoffs(silent, ()) is silent
