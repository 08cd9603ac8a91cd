"""Laws of the planner: it ends in time, on any machine, and says what that costs."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fastsplat.service.common.progress import silent
from fastsplat.service.splatting.plan import (
    SceneSize,
    Speed,
    plan,
    plan_views,
    scene_size,
    step_seconds,
    steps_per_second,
)
from fastsplat.service.splatting.presets import PERCEPTION_PRESETS, PRESETS, with_preset
from fastsplat.service.splatting.probe import machine_speed
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.train import train
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
speeds = st.builds(Speed, st.floats(0.05, 50), st.floats(0.05, 50))
budgets = st.floats(0.01, 5_000)
wishes = st.builds(
    TrainingSettings,
    max_gaussians=st.integers(1, 1_000_000),
    max_side=st.integers(8, 2_000),
    max_sh_degree=st.integers(0, 3),
    iterations=st.integers(1, 30_000),
    label_mode=st.sampled_from(["codes", "evidence", "auto"]),
    surplus_loss_db=st.sampled_from([0.0, 0.05]),
)


@settings(deadline=None, max_examples=60)
@given(wishes, scenes, budgets, speeds, st.floats(0, 20))
@example(TrainingSettings(), TABLE, 60.0, Speed(), 20.0)
@example(TrainingSettings(max_gaussians=1), dataclasses.replace(TABLE, views=1, points=0, labels=0), 1.0, Speed(), 0.0)
def test_a_plan_ends_in_time_or_says_that_the_budget_cannot_be_kept(wanted, scene, budget, speed, tail) -> None:
    found = plan(wanted, scene, budget, speed=speed, spent_s=tail / 2, tail_s=tail)
    assert found.seconds == pytest.approx(sum(found.parts.values()))
    assert found.seconds <= 1.1 * budget or any("time budget itself" in line for line in found.given_up)
    assert found.seconds <= budget * 1.0001 or found.settings.time_budget_s == pytest.approx(0.1 * budget)


@settings(deadline=None, max_examples=60)
@given(wishes, scenes, budgets, speeds)
def test_a_plan_never_asks_for_more_than_was_wanted_and_names_every_loss(wanted, scene, budget, speed) -> None:
    found = plan(wanted, scene, budget, speed=speed)
    chosen, said = found.settings, " | ".join(found.given_up)
    longest = max(scene.width, scene.height)
    assert min(chosen.max_side, longest) <= min(wanted.max_side, longest)
    assert (min(chosen.max_side, longest) < min(wanted.max_side, longest)) == ("resolution" in said)
    assert chosen.max_gaussians <= wanted.max_gaussians
    assert (chosen.max_gaussians < wanted.max_gaussians) == ("Gaussians" in said)
    assert chosen.max_sh_degree <= wanted.max_sh_degree
    assert (chosen.max_sh_degree < wanted.max_sh_degree) == ("harmonics" in said)
    assert wanted.time_budget_s is not None and chosen.time_budget_s is not None
    assert (chosen.time_budget_s < wanted.time_budget_s) == ("optimisation" in said)
    assert chosen.max_gaussians >= 1 and chosen.max_side >= 8 and 1 <= found.steps <= wanted.iterations
    kept = {"max_side", "max_gaussians", "max_sh_degree", "time_budget_s"}
    assert chosen.model_dump(exclude=kept) == wanted.model_dump(exclude=kept)
    TrainingSettings.model_validate(chosen.model_dump())


@settings(deadline=None, max_examples=60)
@given(st.floats(5, 500), st.floats(1.0, 8.0), st.floats(0.2, 4))
def test_more_time_and_a_faster_machine_never_give_up_more(budget, more, factor) -> None:
    wanted = TrainingSettings()
    speed, faster = Speed(factor, factor), Speed(factor * more, factor * more)
    poor = plan(wanted, TABLE, budget, speed=speed)
    for rich in (plan(wanted, TABLE, budget * more, speed=speed), plan(wanted, TABLE, budget, speed=faster)):
        assert rich.settings.max_gaussians >= poor.settings.max_gaussians
        assert rich.settings.max_side >= poor.settings.max_side
        assert rich.settings.max_sh_degree >= poor.settings.max_sh_degree


def test_a_budget_larger_than_needed_gives_up_nothing_and_ends_with_the_steps() -> None:
    wanted = TrainingSettings(iterations=600)
    found = plan(wanted, TABLE, 4_000.0)
    assert found.given_up == () and found.steps == 600 and found.seconds < 200
    assert found.settings.max_gaussians == wanted.max_gaussians and found.settings.max_side == wanted.max_side


def test_a_second_is_too_little_and_the_plan_says_so_but_still_trains() -> None:
    found = plan(TrainingSettings(), TABLE, 1.0, speed=Speed(0.2, 0.2), tail_s=1.0)
    assert found.settings.time_budget_s == pytest.approx(0.1)
    assert found.given_up[-1].startswith("the time budget itself: 1 s")
    assert found.settings.max_gaussians < 5_000 and found.settings.max_sh_degree == 0


def test_one_gaussian_and_one_view_can_be_planned() -> None:
    found = plan(TrainingSettings(max_gaussians=1), SceneSize(1, 8, 8, 0, 0), 10.0)
    assert found.settings.max_gaussians == 1 and found.seconds <= 10.001


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 50), st.integers(1, 400), budgets, st.floats(0, 100), st.floats(0, 10))
def test_perception_keeps_to_its_share_of_the_budget_or_to_three_views(wanted, views, budget, overhead, view) -> None:
    chosen, given_up = plan_views(wanted, views, budget, overhead_s=overhead, view_s=view)
    asked = min(wanted or views, views)
    assert 1 <= chosen <= asked and (chosen < asked) == bool(given_up)
    assert chosen <= 3 or overhead + chosen * view <= 0.4 * budget * 1.0001 + 1e-6
    assert chosen == asked or overhead + (chosen + 1) * view > 0.4 * budget * 0.9999


@pytest.mark.parametrize("budget", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_budgets_are_refused_by_name(budget: float) -> None:
    with pytest.raises(InvalidInputError, match="time_budget_s"):
        plan(TrainingSettings(), TABLE, budget)
    for slow in (Speed(budget, 1.0), Speed(1.0, budget)):
        with pytest.raises(InvalidInputError, match=r"steps|serial"):
            plan(TrainingSettings(), TABLE, 10.0, speed=slow)


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 10**7), st.integers(1, 10**7), st.integers(0, 16))
def test_a_step_costs_more_with_more_of_anything(pixels: int, gaussians: int, channels: int) -> None:
    cost = step_seconds(pixels, gaussians, channels)
    assert 0 < cost < step_seconds(2 * pixels, gaussians, channels)
    assert cost < step_seconds(pixels, 2 * gaussians, channels) and cost < step_seconds(pixels, gaussians, channels + 1)


def test_the_mean_rate_lies_between_the_cheapest_and_the_dearest_step() -> None:
    settings = TrainingSettings()
    rate = steps_per_second(settings, TABLE)
    assert 1 / step_seconds(480 * 360, 40_000, 8) < rate < 1 / step_seconds(240 * 180, 4_955, 8)


def test_presets_cost_more_from_draft_to_best_and_balanced_is_the_default() -> None:
    draft, balanced, best = (with_preset(TrainingSettings(), name) for name in ("draft", "balanced", "best"))
    assert balanced == TrainingSettings() == with_preset(TrainingSettings(), None)
    for less, more in ((draft, balanced), (balanced, best)):
        assert less.time_budget_s is not None and more.time_budget_s is not None
        assert less.time_budget_s < more.time_budget_s and less.max_gaussians < more.max_gaussians
        assert less.max_side <= more.max_side and less.max_sh_degree <= more.max_sh_degree
    assert set(PRESETS) == set(PERCEPTION_PRESETS)
    for name in PRESETS:
        TrainingSettings.model_validate(with_preset(TrainingSettings(), name).model_dump())


def test_a_preset_keeps_what_it_does_not_speak_of_and_replaces_the_rest() -> None:
    own = TrainingSettings(seed=7, max_gaussians=5, semantic_weight=0.5)
    changed = with_preset(own, "draft")
    assert (changed.seed, changed.semantic_weight) == (7, 0.5) and changed.max_gaussians > 5


def test_the_size_of_a_capture_is_that_of_its_largest_image(world) -> None:
    capture, labelling = world
    assert scene_size(capture, len(labelling.dictionary)) == SceneSize(12, 64, 48, len(capture.points), 3)
    assert scene_size(dataclasses.replace(capture, views=()), 0).width == 0


@pytest.mark.parametrize(("views", "gaussians"), [(1, 1), (1, 300), (12, 1)])
def test_the_smallest_plans_train_to_a_whole_scene(make_world, views: int, gaussians: int) -> None:
    capture, labelling = make_world(views)
    wanted = TrainingSettings(max_gaussians=gaussians, surplus_loss_db=0.05)
    found = plan(wanted, scene_size(capture, 3), 1.0)
    trained = train(capture, labelling, found.settings.model_copy(update={"iterations": 30}), silent)
    assert 1 <= len(trained.gaussians) <= gaussians and trained.quality["iterations"] <= 30


def test_the_probe_finds_a_speed() -> None:
    found = machine_speed()
    assert 0.001 < found.steps < 1_000 and 0.001 < found.serial < 1_000
