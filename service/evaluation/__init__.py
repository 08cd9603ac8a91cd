"""Measures of a trained scene against known truth."""

from service.evaluation.segmentation import Confusion, confusion
from service.evaluation.views import ViewsReport, evaluate_views, render_view

__all__ = ["Confusion", "ViewsReport", "confusion", "evaluate_views", "render_view"]
