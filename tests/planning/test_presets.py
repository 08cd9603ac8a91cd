"""Laws of the presets: ordered by cost, complete for training and perception, and applied by one function."""

from __future__ import annotations

from typing import get_args

import pytest

from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.planning.presets import (
    PERCEPTION_PRESETS,
    PRESETS,
    PresetName,
    apply_preset,
    override_training,
)
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat_contract.errors import InvalidInputError


def test_presets_cost_more_from_draft_to_best_and_balanced_is_the_default() -> None:
    draft, balanced, best = (apply_preset(Settings(), name).training for name in ("draft", "balanced", "best"))
    assert balanced == TrainingSettings() == apply_preset(Settings(), None).training
    for less, more in ((draft, balanced), (balanced, best)):
        assert less.time_budget_s is not None and more.time_budget_s is not None
        assert less.time_budget_s < more.time_budget_s and less.max_gaussians < more.max_gaussians
        assert less.max_side <= more.max_side and less.max_sh_degree <= more.max_sh_degree


def test_no_preset_saves_on_harmonics() -> None:
    """They cost few steps, and half a minute is better with them (`benchmarks/results/choices_presets.json`)."""
    default = TrainingSettings().max_sh_degree
    assert {apply_preset(Settings(), name).training.max_sh_degree for name in PRESETS} == {default}


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_valid_and_speaks_of_training_and_of_perception(name: PresetName) -> None:
    assert set(PRESETS) == set(PERCEPTION_PRESETS) == set(get_args(PresetName))
    settings = apply_preset(Settings(), name)
    assert PRESETS[name].items() <= settings.training.model_dump().items()
    assert PERCEPTION_PRESETS[name].items() <= settings.perception.model_dump().items()
    TrainingSettings.model_validate(settings.training.model_dump())
    PerceptionSettings.model_validate(settings.perception.model_dump())


def test_a_preset_replaces_its_own_fields_and_no_others() -> None:
    own = Settings(
        training=TrainingSettings(seed=7, max_gaussians=5, semantic_weight=0.5),
        perception=PerceptionSettings(threads=3, max_views=99),
        http_port=4321,
    )
    changed = apply_preset(own, "draft")
    assert (changed.training.seed, changed.training.semantic_weight) == (7, 0.5) and changed.training.max_gaussians > 5
    assert (changed.perception.threads, changed.perception.max_views) == (3, 12) and changed.http_port == 4321


def test_a_preset_of_another_name_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(InvalidInputError, match="luxury") as refused:
        apply_preset(Settings(), "luxury")
    assert refused.value.field == "preset" and "draft, balanced, best" in str(refused.value.hint)


def test_overrides_leave_out_what_is_none() -> None:
    changed = override_training(Settings(), max_gaussians=77, time_budget_s=None).training
    assert changed == TrainingSettings().model_copy(update={"max_gaussians": 77})
