"""Laws of what a job is expected to take, before it begins and while it runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fastsplat.service.common.progress import ProgressEvent
from fastsplat.service.planning import machine
from fastsplat.service.planning.cost_model import SceneSize, Speed, _steps_of_run, run_seconds_left
from fastsplat.service.planning.job_time import (
    PACED,
    STAGES,
    JobTime,
    PhotoSet,
    job_seconds,
    times_as_long,
    with_time_left,
)
from fastsplat.service.planning.presets import apply_preset
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.training_settings import TrainingSettings

photo_sets = st.builds(PhotoSet, st.integers(2, 1_000), st.integers(100, 8_000), st.integers(100, 8_000))
slownesses = st.floats(0.5, 6.0)


@settings(max_examples=40)
@given(photo_sets, st.floats(0.1, 10))
def test_more_photos_and_larger_ones_take_longer_and_faster_machines_are_faster(photos: PhotoSet, speed: float) -> None:
    chosen, measured = Settings(), Speed(speed, speed, speed)
    here = job_seconds(photos, chosen, measured)
    assert tuple(here) == STAGES and min(here.values()) > 0
    more = job_seconds(replace(photos, count=photos.count + 40), chosen, measured)
    larger = job_seconds(replace(photos, width=2 * photos.width, height=2 * photos.height), chosen, measured)
    assert all(more[stage] >= here[stage] for stage in here) and more["capture"] > here["capture"]
    assert larger["capture"] > here["capture"]
    faster = job_seconds(photos, chosen, measured.slowed(0.5))
    assert all(faster[stage] <= here[stage] for stage in here)
    assert faster["capture"] == pytest.approx(here["capture"] / 2)


def test_a_preset_changes_what_is_expected_of_training() -> None:
    photos = PhotoSet(26, 480, 360)
    draft, balanced, best = (
        job_seconds(photos, apply_preset(Settings(), name), Speed()) for name in ("draft", "balanced", "best")
    )
    assert draft["training"] < balanced["training"] < best["training"]
    assert draft["perception"] < balanced["perception"]
    assert draft["capture"] == balanced["capture"] == best["capture"]


def test_the_masks_of_many_photos_are_looked_for_in_some_of_them() -> None:
    few, many = (job_seconds(PhotoSet(count, 4_000, 3_000), Settings(), Speed()) for count in (16, 160))
    assert many["perception"] < 2 * few["perception"] and many["export"] == few["export"]


def test_load_that_may_end_counts_by_half_and_does_not_disturb_the_measurement(monkeypatch: pytest.MonkeyPatch) -> None:
    speeds = []
    for wall_s in (0.01, 0.09):
        monkeypatch.setattr(machine, "_mean", lambda work, wall_s=wall_s: (0.01, wall_s))
        speeds.append(machine.machine_speed())
    assert dataclasses.astuple(speeds[1]) == pytest.approx(dataclasses.astuple(speeds[0].slowed(3.0)))


def _event(fraction: float, **metrics: float) -> ProgressEvent:
    return ProgressEvent("training", fraction, "", metrics)


def _known(seconds: Mapping[str, float], **more: object) -> JobTime:
    def at(speed: Speed) -> dict[str, float]:
        return {stage: duration / speed.steps for stage, duration in seconds.items()}

    return JobTime(at, Speed(), **more)


def _estimates(stage: str, known: JobTime, *events: tuple[float, ProgressEvent]) -> list[float | None]:
    """Seconds left as they are told with events at these seconds after the stage began; None: unknown."""
    now, reports = [0.0], []
    tell = with_time_left(reports.append, stage, known, lambda: now[0])
    for now[0], event in events:
        tell(event)
    return [None if (left := event.metrics["job_seconds_left"]) == -1 else left for event in reports]


@settings(max_examples=40, deadline=None)
@given(photo_sets, slownesses)
@example(PhotoSet(44, 4_000, 3_000), 6.0)
@example(PhotoSet(25, 779, 520), 0.5)
def test_after_one_stage_the_time_left_is_within_a_factor_of_two_of_the_truth(photos: PhotoSet, k: float) -> None:
    def expected(speed: Speed) -> dict[str, float]:
        return job_seconds(photos, Settings(), speed)

    truth, begun = expected(Speed().slowed(k)), []
    for number, stage in enumerate(STAGES):
        known = JobTime(expected, Speed(), tuple(begun))
        later = sum(truth[after] for after in STAGES[number + 1 :])
        events = [(share * truth[stage], _event(share)) for share in (0.25, 0.5, 0.75, 1.0)]
        for (at, _), left in zip(events, _estimates(stage, known, *events), strict=True):
            true = truth[stage] - at + later
            assert left is not None and left >= 0
            assert (number == 0 and at < max(1.0, truth[stage])) or true / 2 - 0.1 <= left <= 2 * true + 0.1
        if stage in PACED:
            begun.append((expected(Speed())[stage], truth[stage], 1.0))


@given(slownesses, slownesses)
def test_more_stages_are_believed_more_than_one(k: float, slowness: float) -> None:
    single, two = times_as_long([(10.0, 10.0 * k, 1.0)]), times_as_long([(10.0, 10.0 * k, 1.0), (7.0, 7.0 * k, 1.0)])
    assert min(1.0, k) <= min(single, two) and max(single, two) <= max(1.0, k)
    assert abs(two - k) <= abs(single - k) and times_as_long([]) == 1.0
    assert times_as_long([(1.0, slowness, 0.0), (0.0, 5.0, 1.0)]) == 1.0  # nothing seen of it, or nothing expected


@settings(max_examples=40)
@given(st.floats(20, 500), st.floats(0, 500))
def test_it_goes_down_while_a_stage_comes_forward_as_expected(perception_s: float, later: float) -> None:
    known = _known({"perception": perception_s, "training": later, "export": 1.0})
    times = _estimates("perception", known, *((share / 20 * perception_s, _event(share / 20)) for share in range(21)))
    assert all(now < before for before, now in pairwise(times)) and times[-1] == pytest.approx(later + 1.0, abs=0.1)


@settings(max_examples=40)
@given(st.floats(1, 100), st.floats(0, 0.99))
def test_while_a_stage_stands_still_it_is_never_negative_nor_withdrawn(perception_s: float, fraction: float) -> None:
    events = [(20.0 + 5 * tick, _event(fraction)) for tick in range(25)]
    times = _estimates("perception", _known({"perception": perception_s, "training": 5.0, "export": 5.0}), *events)
    assert all(left is not None and left >= 0 for left in times)
    assert times[-1] >= 0.5 * (1 - fraction) * events[-1][0] - 0.1  # as long as it has taken, so long it may still take


@pytest.mark.parametrize("requested", [TrainingSettings(), TrainingSettings(time_budget_s=None, iterations=2_000)])
@settings(max_examples=40, deadline=None)
@given(slownesses, st.floats(0.2, 1.0))
def test_the_rest_of_a_run_is_known_by_its_steps_though_late_ones_take_longer(
    requested, k: float, share: float
) -> None:
    scene = SceneSize(views=26, width=640, height=480, points=300, labels=0)
    measured = Speed(0.2, 0.2, 0.2)
    run = requested.model_copy(update={"min_iterations": min(1_000, requested.iterations)})
    steps, bound = _steps_of_run(run, scene), 1_000 if run.time_budget_s else run.iterations
    at, share = round(share * len(steps)), round(share * len(steps)) / len(steps)
    ran_s, whole_s = (bound / len(steps) * sum(part) * k / 0.2 for part in (steps[:at], steps))
    true_s = max(whole_s, run.time_budget_s or 0.0) - ran_s + run_seconds_left(run, scene, measured, 10**6, 10**6)
    iteration = round(bound * at / len(steps))
    said_s = run_seconds_left(run, scene, measured, iteration, ran_s)
    assert true_s / 2 <= said_s <= 2 * true_s
    known = replace(_known({"training": 60.0, "export": 20.0}), speed=measured, run=(run, scene))
    event = _event(share, iteration=float(iteration), elapsed_s=ran_s)
    times = _estimates("training", known, (ran_s + 3.0, event), (ran_s + 4.0, _event(share)))  # as those of previews
    assert times == pytest.approx([said_s + 100.0, said_s + 99.0], abs=0.2)


def test_a_rate_alone_says_something_only_after_a_while_and_only_if_the_rest_is_known() -> None:
    known = _known({"training": 80.0, "export": 20.0})
    assert _estimates("perception", known, (30.0, _event(0.25))) == [190.0]
    assert (
        _estimates("perception", known, (30.0, _event(0.01)))
        == _estimates("perception", known, (0.5, _event(0.25)))
        == [None]
    )
    assert _estimates("perception", _known({"training": 80.0}), (30.0, _event(0.25))) == [None]
    assert _estimates("perception", known, (30.0, _event(1.0))) == [100.0]


def test_a_time_budget_bounds_what_follows_the_capture_until_it_is_spent() -> None:
    ends = (20.0, _event(0.0)), (121.0, _event(0.0))
    assert _estimates("perception", _known({}, budget_s=120.0), *ends) == [100.0, None]
    whole = _known({"capture": 50.0, "perception": 80.0, "training": 200.0, "export": 9.0}, budget_s=120.0)
    assert _estimates("capture", whole, (20.0, _event(0.0))) == [150.0]
    assert _estimates("perception", whole, (20.0, _event(0.0))) == [100.0]
