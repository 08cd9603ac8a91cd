"""Laws of the presets: ordered by cost, complete for training and perception, and applied by one function."""

from __future__ import annotations

import math
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.planning.cost_model import SceneSize, fit_training
from fastsplat.service.planning.presets import (
    TOLERANCES_DB,
    PresetName,
    apply_preset,
    chosen_settings,
)
from fastsplat.service.planning.time_budget import clock_tradeoff
from fastsplat.service.scene.artefact.assessment import assess
from fastsplat.service.scene.artefact.scene_facts import SceneFacts
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.training_settings import FEWEST_STEPS, GAIN_OF_DOUBLING, MOST_STEPS, TrainingSettings
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.jobs.operations import MAX_TOLERANCE_DB, MIN_TOLERANCE_DB, SceneOptions
from fastsplat_contract.messages.assessments import Assessment


def test_presets_cost_more_from_draft_to_best_and_balanced_is_the_default() -> None:
    draft, balanced, best = (apply_preset(Settings(), name).training for name in ("draft", "balanced", "best"))
    assert balanced == TrainingSettings() == apply_preset(Settings(), None).training
    for less, more in ((draft, balanced), (balanced, best)):
        assert less.time_budget_s is not None and more.time_budget_s is not None
        assert less.time_budget_s < more.time_budget_s and less.max_gaussians < more.max_gaussians
        assert less.max_side <= more.max_side and less.max_sh_degree == more.max_sh_degree


@pytest.mark.parametrize("name", [None, "balanced", "best"])
def test_the_clock_ends_no_run_before_it_has_the_steps_of_a_good_scene(name: PresetName | None) -> None:
    fewest = apply_preset(Settings(), name).training.min_iterations
    assert assess({"images": 40, "iterations": fewest}, SceneFacts(), ()) == Assessment("good", ())
    late = {"images": 40, "iterations": fewest, "time_budget_s": 120.0, "train_seconds": 900.0}
    assert assess(late, SceneFacts(), ()) == Assessment("good", ())  # nobody asked for a time
    assert [finding.reason for finding in assess(late, SceneFacts(time_asked_s=130.0), ()).findings] == ["TOOK_LONGER"]


def test_a_draft_has_a_floor_of_its_own_and_says_that_it_is_one() -> None:
    fewest = apply_preset(Settings(), "draft").training.min_iterations
    assert FEWEST_STEPS < fewest < TrainingSettings().min_iterations
    assert assess({"images": 40, "iterations": fewest}, SceneFacts(), ()).grade == "fair"


@pytest.mark.parametrize("name", TOLERANCES_DB)
def test_a_time_that_was_asked_for_rules_and_says_what_it_cost(name: PresetName) -> None:
    requested = apply_preset(Settings(), name).training
    training = requested.ending_after(20.0)
    assert (training.time_budget_s, training.min_iterations) == (20.0, FEWEST_STEPS)
    assert requested.model_copy(update={"min_iterations": 0}).ending_after(20.0).min_iterations == 0
    planned = fit_training(requested, SceneSize(40, 480, 360, 5_000, 20), 20.0)
    assert planned.settings.min_iterations == FEWEST_STEPS
    (line,) = clock_tradeoff(requested, 20.0, {"iterations": 260.0})
    assert "after 260 steps" in line and f"{requested.min_iterations:,}" in line
    assert clock_tradeoff(requested, 20.0, {"iterations": float(requested.min_iterations)}) == ()
    assert clock_tradeoff(requested, None, {"iterations": 260.0}) == ()
    assert clock_tradeoff(requested, 20.0, {"iterations": 260.0, "stopped_at_share": 0.4}) == ()


@given(st.floats(MIN_TOLERANCE_DB, MAX_TOLERANCE_DB), st.floats(MIN_TOLERANCE_DB, MAX_TOLERANCE_DB))
def test_a_smaller_tolerance_takes_no_less_and_budgets_rule_over_it(first: float, second: float) -> None:
    fine, coarse = (chosen_settings(Settings(), SceneOptions(tolerance_db=value)) for value in sorted((first, second)))
    for field in ("iterations", "min_iterations", "time_budget_s", "max_gaussians", "max_side"):
        assert getattr(fine.training, field) >= getattr(coarse.training, field)
    assert (fine.perception.max_views or math.inf) >= (coarse.perception.max_views or math.inf)
    TrainingSettings.model_validate(fine.training.model_dump())
    budgets = SceneOptions(tolerance_db=first, max_gaussians=77, time_budget_s=20.0)
    assert chosen_settings(Settings(), budgets).training.max_gaussians == 77
    assert chosen_settings(Settings(), budgets).training.iterations == round(GAIN_OF_DOUBLING / first)


@pytest.mark.parametrize("name", get_args(PresetName))
def test_a_preset_is_a_tolerance(name: PresetName) -> None:
    by_tolerance = chosen_settings(Settings(), SceneOptions(tolerance_db=TOLERANCES_DB[name]))
    assert by_tolerance == apply_preset(Settings(), name) == chosen_settings(Settings(), SceneOptions(preset=name))


def test_seconds_alone_are_used_up() -> None:
    assert chosen_settings(Settings(), SceneOptions(time_budget_s=500.0)).training.iterations == MOST_STEPS


def test_a_preset_replaces_its_own_fields_and_no_others() -> None:
    settings = Settings(
        training=TrainingSettings(seed=7, max_gaussians=5, semantic_weight=0.5),
        perception=PerceptionSettings(threads=3, max_views=99),
        http_port=4321,
    )
    changed = apply_preset(settings, "draft")
    assert (changed.training.seed, changed.training.semantic_weight) == (7, 0.5) and changed.training.max_gaussians > 5
    assert (changed.perception.threads, changed.perception.max_views) == (3, 12) and changed.http_port == 4321


def test_a_preset_of_another_name_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(InvalidInputError, match="luxury") as refused:
        apply_preset(Settings(), "luxury")
    assert refused.value.field == "preset" and "draft, balanced, best" in str(refused.value.hint)
