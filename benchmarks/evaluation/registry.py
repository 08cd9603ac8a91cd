"""All metrics, in the order of the report. A new metric is a file that defines it and a line here."""

from __future__ import annotations

from typing import Any

from benchmarks.evaluation.boundary_iou import BOUNDARY_IOU
from benchmarks.evaluation.depth_error import DEPTH_ERROR
from benchmarks.evaluation.image_quality import PSNR, PSNR_COLOR_CORRECTED, SSIM
from benchmarks.evaluation.metrics import SceneMetric, ViewMetric
from benchmarks.evaluation.object_discovery import CLICKS_MIOU, OBJECTS_PRECISION, OBJECTS_RECALL_50, OBJECTS_RECALL_75
from benchmarks.evaluation.published.published_metrics import PUBLISHED
from benchmarks.evaluation.query_scores import LOCALIZATION, MIOU_VIEWS
from benchmarks.evaluation.segmentation import MIOU

METRICS: tuple[ViewMetric[Any] | SceneMetric, ...] = (
    MIOU,
    MIOU_VIEWS,
    BOUNDARY_IOU,
    LOCALIZATION,
    *PUBLISHED,
    PSNR,
    PSNR_COLOR_CORRECTED,
    SSIM,
    DEPTH_ERROR,
    OBJECTS_RECALL_50,
    OBJECTS_RECALL_75,
    OBJECTS_PRECISION,
    CLICKS_MIOU,
)
