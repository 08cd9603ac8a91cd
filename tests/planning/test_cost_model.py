"""Laws of the cost model: a planned run ends in time on any machine, and every reduction is named."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fastsplat.service.planning.cost_model import (
    PerceptionCost,
    SceneSize,
    Speed,
    export_seconds,
    fit_training,
    measure_seconds,
    run_seconds,
    step_seconds,
    steps_per_second,
    views_within_budget,
)
from fastsplat.service.planning.machine import machine_speed
from fastsplat.service.splatting.training_settings import FEWEST_STEPS, TrainingSettings
from fastsplat_contract.errors import InvalidInputError

TABLE = SceneSize(views=40, width=480, height=360, points=4_955, labels=17)

scenes = st.builds(
    SceneSize,
    views=st.integers(1, 500),
    width=st.integers(8, 1_600),
    height=st.integers(8, 1_600),
    points=st.integers(0, 200_000),
    labels=st.integers(0, 200),
)
speeds = st.builds(Speed, st.floats(0.05, 50), st.floats(0.05, 50), st.floats(0.05, 50))
budgets = st.floats(0.01, 5_000)
wishes = st.builds(
    TrainingSettings,
    max_gaussians=st.integers(1, 1_000_000),
    max_side=st.integers(8, 2_000),
    max_sh_degree=st.integers(0, 3),
    iterations=st.integers(1, 30_000),
    label_mode=st.sampled_from(["codes", "evidence", "auto"]),
    tolerance_db=st.sampled_from([0.0, 0.05]),
)


@given(wishes, scenes, budgets, speeds, st.floats(0, 20))
@example(TrainingSettings(), TABLE, 60.0, Speed(), 20.0)
@example(TrainingSettings(max_gaussians=1), dataclasses.replace(TABLE, views=1, points=0, labels=0), 1.0, Speed(), 0.0)
def test_a_plan_ends_in_time_or_says_that_the_budget_cannot_be_kept(requested, scene, budget, speed, tail) -> None:
    planned = fit_training(requested, scene, budget, speed=speed, spent_s=tail / 2, tail_s=tail)
    assert planned.seconds == pytest.approx(sum(planned.parts.values()))
    assert planned.seconds <= 1.1 * budget or any("time budget itself" in line for line in planned.tradeoffs)
    least = planned.settings.time_budget_s == pytest.approx(0.1 * budget) or planned.steps <= FEWEST_STEPS
    assert planned.seconds <= budget * 1.0001 or least


@given(wishes, scenes, budgets, speeds)
def test_a_plan_asks_for_no_more_names_every_loss_and_is_as_long_as_its_run(requested, scene, budget, speed) -> None:
    planned = fit_training(requested, scene, budget, speed=speed)
    chosen, said = planned.settings, " | ".join(planned.tradeoffs)
    longest = max(scene.width, scene.height)
    assert min(chosen.max_side, longest) <= min(requested.max_side, longest)
    assert (min(chosen.max_side, longest) < min(requested.max_side, longest)) == ("resolution" in said)
    assert chosen.max_gaussians <= requested.max_gaussians
    assert (chosen.max_gaussians < requested.max_gaussians) == ("Gaussians" in said)
    assert requested.time_budget_s is not None and chosen.time_budget_s is not None
    assert (chosen.time_budget_s < requested.time_budget_s) == ("optimization" in said)
    assert chosen.max_gaussians >= 1 and chosen.max_side >= 8 and 1 <= planned.steps <= requested.iterations
    fields = {"max_side", "max_gaussians", "time_budget_s", "min_iterations"}
    assert chosen.model_dump(exclude=fields) == requested.model_dump(exclude=fields)
    TrainingSettings.model_validate(chosen.model_dump())
    assert run_seconds(chosen, scene, speed) == pytest.approx(planned.seconds, rel=1e-6)


@given(st.floats(5, 500), st.floats(1.0, 8.0), st.floats(0.2, 4))
def test_more_time_and_a_faster_machine_never_give_up_more(budget, more, factor) -> None:
    requested = TrainingSettings()
    speed, faster = Speed(factor, factor), Speed(factor * more, factor * more)
    poor = fit_training(requested, TABLE, budget, speed=speed)
    for rich in (
        fit_training(requested, TABLE, budget * more, speed=speed),
        fit_training(requested, TABLE, budget, speed=faster),
    ):
        assert rich.settings.max_gaussians >= poor.settings.max_gaussians
        assert rich.settings.max_side >= poor.settings.max_side


def test_a_budget_larger_than_needed_gives_up_nothing_and_ends_with_the_steps() -> None:
    requested = TrainingSettings(iterations=600)
    planned = fit_training(requested, TABLE, 4_000.0)
    assert planned.tradeoffs == () and planned.steps == 600 and planned.seconds < 200
    assert planned.settings.max_gaussians == requested.max_gaussians and planned.settings.max_side == requested.max_side


def test_a_plan_counts_on_the_steps_that_no_clock_ends() -> None:
    """250 steps are trained however slow the machine is, so that the plan has to say what they take."""
    slow = Speed(0.005, 0.02)
    planned = fit_training(TrainingSettings(), TABLE, 20.0, speed=slow)
    optimized = planned.parts["optimize"]
    assert planned.steps == 250 and optimized > 250 / (0.005 * steps_per_second(planned.settings, TABLE)) > 20
    assert "the time budget itself" in planned.tradeoffs[-1]
    by_steps = planned.settings.model_copy(update={"time_budget_s": None, "iterations": 250})
    for same in (planned.settings, by_steps):
        assert run_seconds(same, TABLE, slow) == pytest.approx(planned.seconds)
    free = fit_training(TrainingSettings(min_iterations=0), TABLE, 20.0, speed=slow)
    assert free.parts["optimize"] == free.settings.time_budget_s < optimized


costs = st.builds(PerceptionCost, st.floats(0, 100), st.floats(0, 1), st.floats(0, 10), st.integers(0, 20))


@given(st.integers(0, 50), st.integers(1, 400), budgets, st.floats(0, 100), costs)
def test_perception_keeps_to_its_share_of_the_budget_or_to_three_views(requested, views, budget, spent, cost) -> None:
    chosen, tradeoffs = views_within_budget(requested, views, budget, overhead_s=spent, cost=cost)
    limit = min(requested or views, views)
    assert 1 <= chosen <= limit and (chosen < limit) == bool(tradeoffs)
    assert chosen <= 3 or spent + cost.seconds(chosen) <= 0.4 * budget * 1.0001 + 1e-6
    assert chosen == limit or spent + cost.seconds(chosen + 1) > 0.4 * budget * 0.9999


def test_views_beyond_those_that_are_segmented_cost_their_search_alone() -> None:
    cost = PerceptionCost(overhead_s=1.0, search_s=0.1, segment_s=2.0, segmented=16)
    assert cost.seconds(10) == pytest.approx(1 + 1 + 20)
    assert cost.seconds(40) - cost.seconds(16) == pytest.approx(24 * 0.1)
    assert PerceptionCost(0.0, 0.1, 2.0).seconds(40) == pytest.approx(40 * 2.1)


@pytest.mark.parametrize("budget", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_budgets_are_refused_by_name(budget: float) -> None:
    with pytest.raises(InvalidInputError, match="time_budget_s"):
        fit_training(TrainingSettings(), TABLE, budget)
    for slow in (Speed(budget, 1.0), Speed(1.0, budget)):
        with pytest.raises(InvalidInputError, match=r"steps|serial"):
            fit_training(TrainingSettings(), TABLE, 10.0, speed=slow)


@given(st.integers(1, 10**7), st.integers(1, 10**7), st.integers(0, 16), st.integers(0, 2))
def test_a_step_costs_more_with_more_of_anything(pixels: int, gaussians: int, channels: int, degree: int) -> None:
    cost = step_seconds(pixels, gaussians, channels, degree)
    assert 0 < cost < step_seconds(2 * pixels, gaussians, channels, degree)
    assert cost < step_seconds(pixels, 2 * gaussians, channels, degree)
    assert cost < step_seconds(pixels, gaussians, channels + 1, degree)
    assert cost < step_seconds(pixels, gaussians, channels, degree + 1)


def test_the_measured_speed_of_this_machine_is_plausible() -> None:
    planned = machine_speed()
    assert all(0.001 < times < 1_000 for times in dataclasses.astuple(planned))


@given(st.integers(0, 500), st.integers(1, 500), speeds)
def test_objects_take_longer_the_more_views_tell_of_them(views: int, proposed: int, speed: Speed) -> None:
    def seconds(views: int, proposed: int) -> float:
        return export_seconds(TrainingSettings(), TABLE, 10, views, proposed, speed)

    assert 0 < seconds(views, 0) < seconds(views + 1, 0) < seconds(views + 1, min(views + 1, proposed))


def test_the_last_fit_of_labels_is_planned_for_where_maps_came_with_the_capture() -> None:
    detected = dataclasses.replace(TABLE, labels=0)
    seconds = [
        measure_seconds(TrainingSettings(label_refit_epochs=epochs), scene)
        for scene, epochs in ((detected, 2), (TABLE, 0), (TABLE, 1), (TABLE, 2))
    ]
    assert seconds[0] == seconds[1] < seconds[2] < seconds[3]
