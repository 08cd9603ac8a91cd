"""What an evaluation found, and how it is written down."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from fastsplat.service.evaluation.bootstrap import Interval
from fastsplat.service.evaluation.scoring import QueryScore


@dataclass(frozen=True)
class Report:
    """Figures of one scene on the test views of one data set. NaN: not measured, and `reasons` says why.

    Masks are closed-set unless said otherwise: every pixel has the scene's most probable label there, or none. Counts
    are pooled over views before they are divided; "macro" is the mean over the labels that the truth shows.

    Attributes:
        miou: macro. `details` has `miou_micro` (all labels' pixels pooled), `miou_views` (mean over pairs of view and
            label, what tables of LERF-OVS and 3D-OVS print), and the same three by the encoder's threshold.
        miou_per_class: by label; 0 for a label that is never predicted, NaN for one the truth never shows.
        boundary_iou: macro boundary IoU.
        localization: share of pairs of view and text whose relevancy peaks in one of the text's boxes (LERF).
        pixel_accuracy: share of truly labelled pixels that carry their label.
        ghost_rate: share of pixels within 2 px of a label edge that carry none of the labels within 4 px.
        mask3d_iou: macro IoU of Gaussians; `details["mask3d_truth"]` says where their truth comes from.
        psnr: dB, mean over views.
        ssim: mean over views.
        depth_error: mean of |z − z*| / z*, mean over views.
        absent_auroc: of texts for what is there against nouns for what is not.
        gaussians: number of them.
        bytes: of the scene.
        seconds: by stage.
        peak_mb: of the process that trained, 10^6 bytes.
        intervals: 95 % bootstrap intervals over views, by figure.
        reasons: why a figure is missing.
        queries: every text in every view.
        details: further figures, JSON-ready but for NaN.
    """

    miou: float
    miou_per_class: Mapping[str, float]
    boundary_iou: float
    localization: float
    pixel_accuracy: float
    ghost_rate: float
    mask3d_iou: float
    psnr: float
    ssim: float
    depth_error: float
    absent_auroc: float
    gaussians: int
    bytes: int
    seconds: Mapping[str, float]
    peak_mb: float
    intervals: Mapping[str, Interval | None] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)
    queries: tuple[QueryScore, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Ready for `json.dumps(allow_nan=False)`: what was not measured is null, and `reasons` says why."""
        own = {item.name: getattr(self, item.name) for item in fields(self) if item.name != "details"}
        own["queries"] = [vars(score) for score in self.queries]
        written = {name: _plain(value) for name, value in {**own, **self.details}.items()}
        reasons = dict(self.reasons)
        for name, value in written.items():
            if value is None:
                reasons.setdefault(name, "the truth has nothing to measure it on")
        return {**written, "reasons": reasons}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return round(value, 6) if math.isfinite(value) else None
    return value
