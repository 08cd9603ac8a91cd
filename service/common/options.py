"""What a user may choose for a training job."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

PresetName = Literal["draft", "balanced", "best"]


@dataclass(frozen=True)
class SceneOptions:
    """What a user may choose when posting a scene.

    Attributes:
        labels: names to look for; empty lets the settings' prompt source decide.
        time_budget_s: seconds for everything after the capture stage (perception, training, export), to be kept
            within 10 %; what is given up for it is in the scene's quality. None: the preset's or server's optimisation
            time, however long the rest takes.
        max_gaussians: hard budget, or None for the preset's or the server's default.
        preset: how much to spend (`service.planning.presets`), or None for the server's settings.
        priority: higher ones are trained first.
    """

    labels: tuple[str, ...] = ()
    time_budget_s: float | None = None
    max_gaussians: int | None = None
    preset: PresetName | None = None
    priority: int = 0
