"""Measures of a trained scene against known truth."""

from service.evaluation.report import Report
from service.evaluation.scene import evaluate_scene
from service.evaluation.segmentation import Confusion, confusion
from service.evaluation.views import ViewsReport, evaluate_views, render_view

__all__ = ["Confusion", "Report", "ViewsReport", "confusion", "evaluate_scene", "evaluate_views", "render_view"]
