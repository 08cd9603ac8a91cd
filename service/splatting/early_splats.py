"""Gaussians of a scene before its training is over: on the capture's points, and as a run has them under way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from fastsplat.service.capture.types import Capture
from fastsplat.service.perception.types import Labelling
from fastsplat.service.scene.types import SemanticHead
from fastsplat.service.splatting.gaussians import final_gaussians
from fastsplat.service.splatting.initial import scene_extent, start_gaussians, start_points
from fastsplat.service.splatting.label_supervision import LabelSupervision
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.torch_runtime import one_torch_thread
from fastsplat.service.splatting.training_views import TrainingView, drop_empty_label_maps, load_views
from fastsplat.service.splatting.types import TrainedSplats
from fastsplat.service.splatting.view_evidence import views_evidence

_OPACITY = 0.9
"""Of a point that is asked; a run starts with faint ones, which show everything through everything."""


def point_splats(
    capture: Capture, labelling: Labelling, views: Sequence[int], settings: TrainingSettings
) -> TrainedSplats:
    """Solid Gaussians on the points that a run would start from, with the labels of some views as evidence.

    Args:
        capture: registered images.
        labelling: see `Labelling.learnt`.
        views: numbers of the views that are looked at, at least one.
        settings: as of the run.

    Raises:
        InvalidInputError: as `train`.
    """
    with one_torch_thread():
        loaded = load_views(capture, labelling, tuple(views), settings.max_side, (1.0,))
        start = start_points(capture.points, capture.point_colors, loaded, settings.max_gaussians, settings.seed)
        parameters = start_gaussians(start, scene_extent(loaded, start.points), 0, _OPACITY)
        bare = {"codes": torch.zeros(len(start.points), 0), "weight": torch.zeros(1, 0), "bias": torch.zeros(1)}
        device = device_of(settings.backend)
        moved = tuple(view.to(device) for view in drop_empty_label_maps(loaded))
        return splats_under_way(parameters | bare, labelling, moved, settings, learnt=False)


def splats_under_way(
    parameters: Mapping[str, Tensor],
    labelling: Labelling,
    views: Sequence[TrainingView],
    settings: TrainingSettings,
    *,
    learnt: bool = True,
) -> TrainedSplats:
    """A scene of parameters as they are, without what a finished run measures, corrects and leaves out.

    Args:
        parameters: see `SplatState`.
        labelling: see `Labelling.learnt`.
        views: on the backend's device, with label maps if there are labels.
        settings: as of the run.
        learnt: whether codes were trained on the labels.

    Raises:
        TrainingDivergedError: a parameter is not finite.
    """
    gaussians, head = final_gaussians(parameters, settings.cull_opacity)
    quality = {"gaussians": float(len(gaussians)), "sh_degree": float(gaussians.sh_degree)}
    supervision = LabelSupervision(labelling, settings, device_of(settings.backend))
    if learnt and supervision.mode == "codes":
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
