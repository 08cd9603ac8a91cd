"""Metrics of a trained scene on data sets whose truth is known."""

from fastsplat.service.evaluation.evaluation_report import Report, RunCost
from fastsplat.service.evaluation.held_out_views import ViewsReport, evaluate_views, render_view
from fastsplat.service.evaluation.registry import METRICS
from fastsplat.service.evaluation.scene_evaluation import evaluate_scene

__all__ = ["METRICS", "Report", "RunCost", "ViewsReport", "evaluate_scene", "evaluate_views", "render_view"]
