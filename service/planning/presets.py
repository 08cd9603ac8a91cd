"""Tolerances between speed and quality; presets are three of them (`docs/method.md`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from fastsplat.service.splatting.training_settings import GAIN_OF_DOUBLING, MOST_STEPS, TrainingSettings
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.jobs.operations import PresetName as PresetName
from fastsplat_contract.jobs.operations import SceneOptions

if TYPE_CHECKING:  # clients load the names, but not the settings
    from fastsplat.service.settings import Settings


TOLERANCES_DB: Mapping[PresetName, float] = MappingProxyType({"draft": 0.8, "balanced": 0.3, "best": 0.1})
"""What the presets are: PSNR of held-out views, dB, that twice the steps may still gain."""
_FEW_VIEWS_FROM_DB = 0.8
"""Tolerance from which on not every view is detected in, and few are enough."""
_FEW_VIEWS = 12


def tolerance_changes(tolerance_db: float) -> dict[str, Any]:
    """Changes to `TrainingSettings` for a tolerance, all on one curve through "balanced", the settings' own defaults.

    Args:
        tolerance_db: PSNR of held-out views, dB, that twice the steps may still gain.
    """
    default = TrainingSettings()
    finer = default.tolerance_db / tolerance_db
    steps = round(GAIN_OF_DOUBLING / tolerance_db)
    return {
        "tolerance_db": tolerance_db,
        "iterations": steps,
        "min_iterations": min(default.min_iterations, steps // 2),
        "time_budget_s": round((default.time_budget_s or math.inf) * finer, 1),
        "max_gaussians": round(default.max_gaussians / 1_000 * finer ** (2 / 3)) * 1_000,
        "max_side": round(default.max_side * finer**0.3),
    }


def apply_preset(settings: Settings, name: str | None) -> Settings:
    """Applies a preset for training and perception, if any; raises as `preset_name`."""
    return settings if name is None else _within(settings, TOLERANCES_DB[preset_name(name)])


def chosen_settings(settings: Settings, options: SceneOptions) -> Settings:
    """Applies a user's tolerance or preset, lens and budgets to the operator's settings.

    Seconds that are given without a tolerance are used up, as are the views.
    """
    if options.tolerance_db is not None:
        settings = _within(settings, options.tolerance_db)
    elif options.preset is not None:
        settings = apply_preset(settings, options.preset)
    elif options.time_budget_s is not None:
        settings = override_training(settings, iterations=max(settings.training.iterations, MOST_STEPS))
    lens = {name: value for name in ("lens", "nadir_deg") if (value := getattr(options, name)) is not None}
    settings = settings.model_copy(update={"capture": settings.capture.model_copy(update=lens)})
    return override_training(settings, max_gaussians=options.max_gaussians)


def _within(settings: Settings, tolerance_db: float) -> Settings:
    views = _FEW_VIEWS if tolerance_db >= _FEW_VIEWS_FROM_DB else 0
    perception = settings.perception.model_copy(update={"max_views": views, "closer_look": True})
    changed = override_training(settings, **tolerance_changes(tolerance_db))
    return changed.model_copy(update={"perception": perception})


def preset_name(text: str) -> PresetName:
    """Validates the name of a preset; raises `InvalidInputError`."""
    for name in TOLERANCES_DB:
        if name == text:
            return name
    raise InvalidInputError(f"no preset {text[:40]!r}", field="preset", hint=f"Use one of {', '.join(TOLERANCES_DB)}.")


def override_training(settings: Settings, **values: Any) -> Settings:
    """Replaces fields of `settings.training`; a value of None changes nothing."""
    changes = {name: value for name, value in values.items() if value is not None}
    return settings.model_copy(update={"training": settings.training.model_copy(update=changes)})
