"""Gaussians of a scene before its training is over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from torch import Tensor

from fastsplat.service.perception.types import Labelling
from fastsplat.service.scene.types import SemanticHead
from fastsplat.service.splatting.gaussians import final_gaussians
from fastsplat.service.splatting.label_supervision import LabelSupervision
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.training_views import TrainingView
from fastsplat.service.splatting.types import TrainedSplats
from fastsplat.service.splatting.view_evidence import views_evidence


def splats_under_way(
    parameters: Mapping[str, Tensor], labelling: Labelling, views: Sequence[TrainingView], settings: TrainingSettings
) -> TrainedSplats:
    """A scene of parameters as they are (see `SplatState`), of views on the backend's device; without what a finished
    run measures, corrects and leaves out. `TrainingDivergedError` where a parameter is not finite."""
    gaussians, head = final_gaussians(parameters, settings.cull_opacity)
    quality = {"gaussians": float(len(gaussians)), "sh_degree": float(gaussians.sh_degree)}
    supervision = LabelSupervision(labelling, settings, device_of(settings.backend))
    if supervision.mode == "codes":
        return TrainedSplats(gaussians, head, quality, ())
    evidence = None
    if supervision.labels:
        evidence = views_evidence(
            gaussians,
            views,
            supervision.labels + 1,
            undetected_weight=supervision.undetected_weight,
            backend=settings.backend,
        )
    return TrainedSplats(gaussians, SemanticHead.unlearnt(supervision.labels), quality, (), evidence)
