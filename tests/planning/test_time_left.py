"""What is said of a job's remaining time: what the stage says, else the model, else its rate; or nothing."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from fastsplat.service.common.progress import ProgressEvent
from fastsplat.service.planning.cost_model import SceneSize, Speed, fit_training, run_seconds
from fastsplat.service.planning.time_left import Forecast, with_time_left
from fastsplat.service.splatting.settings import TrainingSettings


def _event(fraction: float, **metrics: float) -> ProgressEvent:
    return ProgressEvent("training", fraction, "", metrics)


def test_a_rate_says_something_only_after_a_while_and_only_if_the_rest_is_known() -> None:
    assert Forecast(100.0).seconds_left(_event(0.25), 30.0) == pytest.approx(190.0)
    assert Forecast(100.0).seconds_left(_event(0.01), 30.0) is None
    assert Forecast(100.0).seconds_left(_event(0.25), 0.5) is None
    assert Forecast(None).seconds_left(_event(0.25), 30.0) is None
    assert Forecast(100.0).seconds_left(_event(1.0), 30.0) == 100.0


def test_what_the_stage_says_goes_before_the_model_and_what_is_overdue_is_unknown() -> None:
    forecast = Forecast(later_s=20.0, own_s=60.0, tail_s=5.0)
    assert forecast.seconds_left(_event(0.0), 10.0) == 70.0
    assert forecast.seconds_left(_event(0.5, seconds_left=200.0), 90.0) == 225.0
    assert forecast.seconds_left(_event(0.9), 61.0) is None


def test_a_time_budget_bounds_it_until_it_is_spent() -> None:
    forecast = Forecast(later_s=None, bound_s=120.0)
    assert forecast.seconds_left(_event(0.0), 20.0) == 100.0
    assert forecast.seconds_left(_event(0.0), 121.0) is None
    assert Forecast(later_s=10.0, bound_s=120.0).seconds_left(_event(0.5), 20.0) == 30.0


def test_events_say_it_and_say_when_it_is_no_longer_known() -> None:
    def ticks() -> Iterator[float]:
        yield from (0.0, 10.0, 70.0)

    clock, told = ticks(), []
    tell = with_time_left(told.append, Forecast(0.0, own_s=60.0), lambda: next(clock))
    tell(_event(0.1, loss=1.0))
    tell(_event(0.9))
    assert [event.metrics for event in told] == [{"loss": 1.0, "job_seconds_left": 50.0}, {"job_seconds_left": -1.0}]


def test_a_run_is_as_long_as_its_plan_says() -> None:
    scene = SceneSize(views=26, width=640, height=480, points=3_000, labels=20)
    for speed in (Speed(), Speed(0.5, 0.7)):
        plan = fit_training(TrainingSettings(), scene, 120.0, speed=speed)
        assert run_seconds(plan.settings, scene, speed) == pytest.approx(plan.seconds, rel=1e-6)
    unbounded = TrainingSettings(time_budget_s=None)
    slow, fast = run_seconds(unbounded, scene, Speed(0.5, 0.5)), run_seconds(unbounded, scene)
    assert slow == pytest.approx(2 * fast, rel=1e-6)
