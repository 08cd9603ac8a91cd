"""All metrics, in the order of the report. A new metric is a file that defines it and a line here."""

from __future__ import annotations

from typing import Any

from fastsplat.service.evaluation.boundary_iou import BOUNDARY_IOU, BOUNDARY_IOU_MICRO
from fastsplat.service.evaluation.depth_error import DEPTH_COVERAGE, DEPTH_ERROR, DEPTH_MEDIAN, DEPTH_MEDIAN_ABS
from fastsplat.service.evaluation.ghost_labels import GHOST_RATE, GHOST_RATE_NAMED, GHOST_SHARE_OF_PIXELS
from fastsplat.service.evaluation.image_quality import PSNR, PSNR_COLOR_CORRECTED, SSIM, SSIM_ZERO_PADDED
from fastsplat.service.evaluation.mask3d_iou import MASK3D_IOU
from fastsplat.service.evaluation.negative_queries import ABSENT_AUROC
from fastsplat.service.evaluation.published.published_metrics import PUBLISHED
from fastsplat.service.evaluation.query_scores import (
    LOCALIZATION,
    LOCALIZATION_PEAK_IN_MASK,
    MIOU_THRESHOLD_VIEWS,
    MIOU_VIEWS,
)
from fastsplat.service.evaluation.segmentation import (
    MIOU,
    MIOU_MICRO,
    MIOU_THRESHOLD,
    MIOU_THRESHOLD_MICRO,
    PIXEL_ACCURACY,
)
from fastsplat.service.evaluation.thing_discovery import (
    CLICKS_MIOU,
    THINGS_AP50,
    THINGS_PRECISION,
    THINGS_RECALL_50,
    THINGS_RECALL_75,
)
from fastsplat.service.evaluation.types import SceneMetric, ViewMetric

METRICS: tuple[ViewMetric[Any] | SceneMetric, ...] = (
    MIOU,
    MIOU_MICRO,
    MIOU_VIEWS,
    MIOU_THRESHOLD,
    MIOU_THRESHOLD_MICRO,
    MIOU_THRESHOLD_VIEWS,
    BOUNDARY_IOU,
    BOUNDARY_IOU_MICRO,
    PIXEL_ACCURACY,
    LOCALIZATION,
    LOCALIZATION_PEAK_IN_MASK,
    *PUBLISHED,
    GHOST_RATE,
    GHOST_RATE_NAMED,
    GHOST_SHARE_OF_PIXELS,
    MASK3D_IOU,
    PSNR,
    PSNR_COLOR_CORRECTED,
    SSIM,
    SSIM_ZERO_PADDED,
    DEPTH_ERROR,
    DEPTH_MEDIAN,
    DEPTH_MEDIAN_ABS,
    DEPTH_COVERAGE,
    ABSENT_AUROC,
    THINGS_RECALL_50,
    THINGS_RECALL_75,
    THINGS_PRECISION,
    THINGS_AP50,
    CLICKS_MIOU,
)
