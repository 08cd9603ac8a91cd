"""What is measured: runs at tolerances, beside fixed recipes; and what recognition of fewer views saves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from benchmarks.splits import HELD_OUT
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.planning.presets import TOLERANCES_DB, tolerance_changes
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.training_settings import TrainingSettings

BASE: dict[str, Any] = {"time_budget_s": None, "held_out_every": HELD_OUT, "evaluations": 0}
"""Bounded by steps, which makes it reproducible. Scores are taken at the images' own size."""

_DETECTED = {"iterations": 200, "max_gaussians": 10_000, "max_side": 240, "max_sh_degree": 1, "tolerance_db": 0.0}
_RECIPE = {"max_gaussians": 40_000, "tolerance_db": 0.0}

Data = Literal["tabletop", "sample", "skull"]

DATA: tuple[Data, ...] = ("tabletop", "sample", "skull")
_STEPS = (2_000, 5_000)
"""As many as the tolerance of "balanced" takes, and as many as two minutes have on two AVX-512 cores."""


@dataclass(frozen=True)
class Row:
    """One measurement.

    Attributes:
        data: what is trained.
        factor, value: what is changed against the base, and to what, in words.
        training: `TrainingSettings` in place of `BASE`'s.
        perception: `PerceptionSettings` in place of their defaults; None takes the exact label maps.
    """

    data: Data
    factor: str
    value: str
    training: dict[str, Any] = field(default_factory=dict)
    perception: dict[str, Any] | None = None

    @property
    def key(self) -> str:
        """Unique."""
        return f"{self.data}/{self.factor}/{self.value}"

    def settings(self, models: Path) -> Settings:
        """Of all rooms; `models` is the model directory."""
        return Settings(
            models=models,
            training=TrainingSettings.model_validate({**BASE, **self.training}),
            perception=PerceptionSettings.model_validate({"threads": 2, **(self.perception or {})}),
        )


def all_rows() -> list[Row]:
    """In the order in which they are measured: what matters most first."""
    balanced = TOLERANCES_DB["balanced"]
    rows = [Row(data, "tolerance", f"{value} dB", _within(value)) for data in DATA for value in (balanced, 0.8, 2.0)]
    rows += [
        Row(data, "recipe", f"{steps:,} steps", {**_RECIPE, "iterations": steps}) for data in DATA for steps in _STEPS
    ]
    rows += [
        Row(data, f"seed {seed}", f"{balanced} dB", {**_within(balanced), "seed": seed})
        for data in DATA
        for seed in (1, 2)
    ]
    rows += _detected()
    return rows + [Row(data, "tolerance", f"{value} dB", _within(value)) for value in (0.1,) for data in DATA[:2]]


def _within(tolerance_db: float) -> dict[str, Any]:
    return {**tolerance_changes(tolerance_db), **BASE}


def _detected() -> Iterator[Row]:
    for views in (0, 6):
        yield Row("sample", "perception views", f"{views or 21}", _DETECTED, {"max_views": views})
    yield Row("sample", "closer look", "off", _DETECTED, {"max_views": 6, "closer_look": False})
