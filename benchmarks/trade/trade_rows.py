"""What is measured: a base, and one factor changed at a time; the frontier; presets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from benchmarks.splits import HELD_OUT
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.planning.cost_model import SceneSize, steps_per_second
from fastsplat.service.planning.presets import PRESETS
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat_contract.jobs.operations import PresetName

BASE: dict[str, Any] = {
    "iterations": 400,
    "time_budget_s": None,
    "max_side": 240,
    "max_gaussians": 20_000,
    "max_sh_degree": 1,
    "held_out_every": HELD_OUT,
    "evaluations": 0,
    "tolerance_db": 0.0,
}
"""Balanced, but shorter, at a quarter of the pixels of the two captures and with half the Gaussians, so that all rows
fit an hour; and bounded by steps, which makes it reproducible. Scores are taken at the images' own 480×360."""

_DETECTED = {"iterations": 200, "max_gaussians": 10_000}
_TABLETOP = SceneSize(40, 480, 360, 4_955, 17)

Data = Literal["tabletop", "sample", "skull"]
DATA: tuple[Data, ...] = ("tabletop", "sample")


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
    rows = [Row("tabletop", "base", "base")]
    rows += _frontier()
    rows += _sweeps()
    rows += _detected()
    rows += [Row(data, "preset", name, _preset(name)) for name in PRESETS for data in DATA]
    return rows


def _preset(name: PresetName) -> dict[str, Any]:
    """Bounded by the steps that fit the preset's time on the reference machine, so that a busy one gets there too."""
    settings = TrainingSettings.model_validate(PRESETS[name])
    assert settings.time_budget_s is not None
    steps = round(settings.time_budget_s * steps_per_second(settings, _TABLETOP))
    return {**PRESETS[name], "time_budget_s": None, "iterations": steps}


def _sweeps() -> Iterator[Row]:
    recipe = {"max_gaussians": 200_000, "max_sh_degree": 3, "code_size": 16}
    changes: list[tuple[str, str, dict[str, Any]]] = [
        ("label mode", "evidence", {"label_mode": "evidence"}),
        ("fixed recipe", "200000, degree 3, code 16", recipe),
        ("fixed recipe", "the same, 0.05 dB of surplus", {**recipe, "tolerance_db": 0.05}),
        ("steps", "1600", {"iterations": 1_600}),
        *(("code size", f"{value}", {"code_size": value}) for value in (3, 13)),
        *(("harmonics", f"degree {value}", {"max_sh_degree": value}) for value in (0, 3)),
        *(("surplus", f"{value} dB", {"tolerance_db": value}) for value in (0.05, 0.2)),
        *(("Gaussians", f"{value}", {"max_gaussians": value}) for value in (5_000, 10_000, 40_000, 80_000)),
        *(("resolution", f"{value} px", {"max_side": value}) for value in (120, 170, 340, 480)),
    ]
    for factor, value, training in changes:
        yield Row("tabletop", factor, value, training)


def _frontier() -> Iterator[Row]:
    """The same computing time spent on many steps over little, or on few over much."""
    for seconds in (4, 16):
        for side, count in ((120, 5_000), (170, 10_000), (240, 20_000), (340, 20_000), (480, 40_000)):
            bounds = {**BASE, "max_side": side, "max_gaussians": count}
            steps = round(seconds * steps_per_second(TrainingSettings.model_validate(bounds), _TABLETOP))
            changes = {"max_side": side, "max_gaussians": count, "iterations": steps}
            yield Row("tabletop", f"frontier {seconds} s", f"{side} px, {count}", changes)


def _detected() -> Iterator[Row]:
    for views in (0, 6):
        yield Row("sample", "perception views", f"{views or 21}", _DETECTED, {"max_views": views})
    yield Row("sample", "closer look", "off", _DETECTED, {"max_views": 6, "closer_look": False})
    yield Row("sample", "segmenter", "sam2_hiera_tiny", _DETECTED, {"max_views": 6, "segmenter": "sam2_hiera_tiny"})
