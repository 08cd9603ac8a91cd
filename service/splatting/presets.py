"""Three named choices between speed and quality, read off the frontier that `make bench-trade` measures."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat_contract.operations import PresetName

PRESETS: Mapping[PresetName, Mapping[str, Any]] = MappingProxyType(
    {
        "draft": MappingProxyType(
            {"time_budget_s": 30.0, "max_gaussians": 20_000, "max_side": 480, "max_sh_degree": 0, "evaluations": 3}
        ),
        "balanced": MappingProxyType(
            {
                name: TrainingSettings.model_fields[name].default
                for name in ("time_budget_s", "max_gaussians", "max_side", "max_sh_degree", "evaluations")
            }
        ),
        "best": MappingProxyType(
            {"time_budget_s": 480.0, "max_gaussians": 100_000, "max_side": 960, "max_sh_degree": 3, "evaluations": 10}
        ),
    }
)
"""What each preset changes of `TrainingSettings`; "balanced" is the settings' own defaults, said explicitly."""

PERCEPTION_PRESETS: Mapping[PresetName, Mapping[str, Any]] = MappingProxyType(
    {
        "draft": MappingProxyType({"max_views": 12, "closer_look": True}),
        "balanced": MappingProxyType({"max_views": 0, "closer_look": True}),
        "best": MappingProxyType({"max_views": 0, "closer_look": True}),
    }
)
"""What each preset changes of `service.perception.settings.PerceptionSettings`."""


def with_preset(settings: TrainingSettings, name: PresetName | None) -> TrainingSettings:
    """`settings` with a preset's choices in the place of their own; None changes nothing."""
    return settings if name is None else settings.model_copy(update=dict(PRESETS[name]))
