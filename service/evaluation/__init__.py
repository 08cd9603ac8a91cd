"""Metrics of a trained scene on data sets whose truth is known.

The names below load what they need (torchmetrics, scipy) only when they are first used, so that a training in the same
process does without them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fastsplat.service.evaluation.evaluation_report import Report, RunCost
    from fastsplat.service.evaluation.held_out_views import ViewsReport, evaluate_views, render_view
    from fastsplat.service.evaluation.registry import METRICS
    from fastsplat.service.evaluation.scene_evaluation import evaluate_scene

__all__ = ["METRICS", "Report", "RunCost", "ViewsReport", "evaluate_scene", "evaluate_views", "render_view"]

_HOMES = {
    "METRICS": "registry",
    "Report": "evaluation_report",
    "RunCost": "evaluation_report",
    "ViewsReport": "held_out_views",
    "evaluate_scene": "scene_evaluation",
    "evaluate_views": "held_out_views",
    "render_view": "held_out_views",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
