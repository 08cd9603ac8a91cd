"""Presets between speed and quality, from `make bench NAME=trade` and validation views."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.jobs.operations import PresetName as PresetName
from fastsplat_contract.jobs.operations import SceneOptions

if TYPE_CHECKING:  # clients load the names, but not the settings
    from fastsplat.service.settings import Settings


_FIELDS = (
    "time_budget_s", "min_iterations", "max_gaussians", "max_side", "max_sh_degree", "evaluations", "tolerance_db",
)  # fmt: skip
_VALUES: Mapping[PresetName, tuple[Any, ...]] = {
    "draft": (30.0, 500, 20_000, 480, 3, 3, 0.3),
    "balanced": tuple(TrainingSettings.model_fields[name].default for name in _FIELDS),
    "best": (480.0, 1_000, 100_000, 960, 3, 10, 0.03),
}
PRESETS: Mapping[PresetName, Mapping[str, Any]] = MappingProxyType(
    {preset: MappingProxyType(dict(zip(_FIELDS, values, strict=True))) for preset, values in _VALUES.items()}
)
"""Changes to `TrainingSettings` by preset; "balanced" is the settings' own defaults."""

PERCEPTION_PRESETS: Mapping[PresetName, Mapping[str, Any]] = MappingProxyType(
    {
        "draft": MappingProxyType({"max_views": 12, "closer_look": True}),
        "balanced": MappingProxyType({"max_views": 0, "closer_look": True}),
        "best": MappingProxyType({"max_views": 0, "closer_look": True}),
    }
)
"""Changes to `service.perception.perception_settings.PerceptionSettings` by preset."""


def apply_preset(settings: Settings, name: str | None) -> Settings:
    """Applies a preset for training and perception, if any; raises as `preset_name`."""
    if name is None:
        return settings
    preset = preset_name(name)
    training = settings.training.model_copy(update=dict(PRESETS[preset]))
    perception = settings.perception.model_copy(update=dict(PERCEPTION_PRESETS[preset]))
    return settings.model_copy(update={"training": training, "perception": perception})


def chosen_settings(settings: Settings, options: SceneOptions) -> Settings:
    """Applies a user's preset, lens and limit of Gaussians to the operator's settings."""
    settings = apply_preset(settings, options.preset)
    lens = {name: value for name in ("lens", "nadir_deg") if (value := getattr(options, name)) is not None}
    settings = settings.model_copy(update={"capture": settings.capture.model_copy(update=lens)})
    return override_training(settings, max_gaussians=options.max_gaussians)


def preset_name(text: str) -> PresetName:
    """Validates the name of a preset; raises `InvalidInputError`."""
    for name in PRESETS:
        if name == text:
            return name
    raise InvalidInputError(f"no preset {text[:40]!r}", field="preset", hint=f"Use one of {', '.join(PRESETS)}.")


def override_training(settings: Settings, **values: Any) -> Settings:
    """Replaces fields of `settings.training`; a value of None changes nothing."""
    changes = {name: value for name, value in values.items() if value is not None}
    return settings.model_copy(update={"training": settings.training.model_copy(update=changes)})
