"""Measures of a trained scene against known truth."""

from fastsplat.service.evaluation.report import Report
from fastsplat.service.evaluation.scene import evaluate_scene
from fastsplat.service.evaluation.segmentation import Confusion, confusion
from fastsplat.service.evaluation.views import ViewsReport, evaluate_views, render_view

__all__ = ["Confusion", "Report", "ViewsReport", "confusion", "evaluate_scene", "evaluate_views", "render_view"]
