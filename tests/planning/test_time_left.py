"""What is said of a job's remaining time: what the stage says, else the model, else its rate; or nothing."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import pytest

from fastsplat.service.common.progress import ProgressEvent
from fastsplat.service.planning.cost_model import SceneSize, Speed, fit_training, run_seconds
from fastsplat.service.planning.time_left import Forecast, with_time_left
from fastsplat.service.splatting.settings import TrainingSettings


def _event(fraction: float, **metrics: float) -> ProgressEvent:
    return ProgressEvent("training", fraction, "", metrics)


def _told(forecast: Forecast, *events: tuple[float, ProgressEvent]) -> list[float | None]:
    """Seconds left as they are told with events at these seconds after the stage began; None: unknown."""
    now, told = [0.0], []
    tell = with_time_left(told.append, forecast, lambda: now[0])
    for now[0], event in events:
        tell(event)
    return [None if (left := event.metrics["job_seconds_left"]) == -1 else left for event in told]


def test_a_rate_says_something_only_after_a_while_and_only_if_the_rest_is_known() -> None:
    assert _told(Forecast(100.0), (30.0, _event(0.25))) == [190.0]
    assert _told(Forecast(100.0), (30.0, _event(0.01))) == [None]
    assert _told(Forecast(100.0), (0.5, _event(0.25))) == [None]
    assert _told(Forecast(None), (30.0, _event(0.25))) == [None]
    assert _told(Forecast(100.0), (30.0, _event(1.0))) == [100.0]


def test_what_the_stage_says_goes_before_the_model_and_what_is_overdue_is_unknown() -> None:
    forecast = Forecast(later_s=20.0, own_s=60.0, tail_s=5.0)
    assert _told(forecast, (10.0, _event(0.0))) == [70.0]
    said = (90.0, _event(0.5, seconds_left=200.0))
    assert _told(forecast, said, (100.0, _event(0.5))) == [225.0, 215.0]  # events without it, as those of previews
    assert _told(forecast, (61.0, _event(0.9))) == [None]


def test_a_time_budget_bounds_it_until_it_is_spent() -> None:
    assert _told(Forecast(None, bound_s=120.0), (20.0, _event(0.0)), (121.0, _event(0.0))) == [100.0, None]
    assert _told(Forecast(10.0, bound_s=120.0), (20.0, _event(0.5))) == [30.0]


@pytest.mark.parametrize("forecast", [Forecast(5.0), Forecast(5.0, own_s=40.0), Forecast(5.0, own_s=40.0, tail_s=2.0)])
@pytest.mark.parametrize("metrics", [{}, {"seconds_left": 33.0}])
def test_while_a_stage_stands_still_its_time_left_counts_down_or_is_withdrawn(
    forecast: Forecast, metrics: dict[str, float]
) -> None:
    events = [(20.0 + 2 * number, _event(0.5)) for number in range(60)]
    first, *later = _told(forecast, (20.0, _event(0.5, **metrics)), *events[1:])
    assert first is not None and later[-1] is None
    known = [first, *(left for left in later if left is not None)]
    assert all(now == pytest.approx(before - 2) for before, now in pairwise(known))
    assert later[len(known) - 1 :] == [None] * (len(later) - len(known) + 1)


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
