"""Lifts labels of views onto the fixed Gaussians of an imported splat."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.scene import Evidence, Gaussians, SemanticHead
from fastsplat.service.scene.objects.label_evidence import posterior
from fastsplat.service.splat_import.bulk import uncoded_gaussians
from fastsplat.service.splat_import.splat_import_settings import SplatImportSettings
from fastsplat.service.splatting.gaussians import color_parameters
from fastsplat.service.splatting.labels.label_refit import LabeledView, codes_from_labels
from fastsplat.service.splatting.labels.semantics import ghost_share
from fastsplat.service.splatting.labels.view_evidence import views_evidence
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.torch_runtime import one_torch_thread
from fastsplat.service.splatting.training.quality import mean_color, pictures, psnr
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import TrainingView, drop_empty_label_maps, load_views
from fastsplat_contract.errors import InvalidInputError

_STAGE = "training"
_MEASURED_VIEWS = 8
_LIFTED = 0.5  # share of the progress at which the evidence is complete
_LOOKED_AT = 600_000
"""Limit on Gaussians times passes over the views; one pass is always allowed."""


def lift_labels(
    capture: Capture,
    labelling: Labelling,  # a label map per view; an empty dictionary gives a scene without labels
    training: TrainingSettings,
    settings: SplatImportSettings,
    progress: Progress,  # of the stage "training"; may raise CancelledError
) -> TrainedSplats:
    """Labels the capture's splat; its Gaussians stay unchanged.

    Of `training`, only backend, max_side, seed, label_mode, code_size and undetected_weight are used.

    Raises:
        InvalidInputError: the photos do not show the splat from their poses.
    """
    begun = time.monotonic()
    assert capture.splat is not None
    gaussians = uncoded_gaussians(capture.splat)
    with one_torch_thread():
        progress(ProgressEvent(_STAGE, 0.0, f"loading {len(capture.views)} views"))
        views = load_views(capture, labelling, tuple(range(len(capture.views))), training.max_side, (1.0,))
        device = device_of(training.backend)
        views = tuple(view.to(device) for view in views)
        quality = {"gaussians": float(len(gaussians)), "sh_degree": float(gaussians.sh_degree)}
        if capture.report.source != "splat":
            quality |= _check_fit(gaussians, views, training.backend)
        labels = len(labelling.dictionary) if labelling.label_maps else 0
        progress(ProgressEvent(_STAGE, 0.1, f"lifting {labels} labels onto {len(gaussians)} Gaussians"))
        undetected = 1.0 if labelling.exact else training.undetected_weight
        views = drop_empty_label_maps(views)
        evidence = views_evidence(gaussians, views, labels + 1, undetected_weight=undetected, backend=training.backend)
        if training.label_mode == "evidence" or not labels:
            head = SemanticHead.unlearnt(labels)
            lifted, stored_evidence = gaussians, evidence if labels else None
        else:
            lifted, head = _with_codes(gaussians, views, evidence, labels + 1, undetected, training, settings, progress)
            stored_evidence = None
            quality["ghost_share"] = ghost_share(lifted.codes, lifted.logit_opacities, head)
    quality["lifting_seconds"] = time.monotonic() - begun
    progress(ProgressEvent(_STAGE, 1.0, f"{labels} labels on {len(gaussians)} Gaussians"))
    return TrainedSplats(lifted, head, quality, (), stored_evidence)


def _with_codes(
    gaussians: Gaussians,
    views: Sequence[TrainingView],
    evidence: Evidence,
    classes: int,
    undetected: float,
    training: TrainingSettings,
    settings: SplatImportSettings,
    progress: Progress,
) -> tuple[Gaussians, SemanticHead]:
    """Fits codes and head, starting at each Gaussian's most probable class."""
    labeled = [
        LabeledView(view.viewmat, view.frames[-1].camera, labels, view.frames[-1].valid)
        for view in views
        if (labels := view.frames[-1].labels) is not None
    ]
    steps = min(settings.code_steps, len(labeled) * max(1, _LOOKED_AT // len(gaussians)))

    def after_step(step: int, loss: float) -> None:
        share = _LIFTED + (1 - _LIFTED) * step / steps
        progress(ProgressEvent(_STAGE, share, f"codes, step {step} of {steps}", {"loss": loss}))

    codes, head = codes_from_labels(
        gaussians,
        labeled,
        evidence,
        posterior(evidence, classes).classes,
        classes,
        size=training.code_size,
        none_weight=undetected,
        steps=steps,
        seed=training.seed,
        backend=training.backend,
        after_step=after_step,
    )
    return replace(gaussians, codes=codes), head


@torch.no_grad()
def _check_fit(gaussians: Gaussians, views: Sequence[TrainingView], backend: Backend) -> dict[str, float]:
    """Mean PSNR (dB) of the splat over some photos; `InvalidInputError` if most are more like one color each."""
    used = [view for view in views if view.frames[-1].has_content]
    if not used:
        return {}
    figures, worse = [], 0
    parameters = color_parameters(gaussians, device_of(backend))
    for _, image, target, valid in pictures(parameters, used[:: math.ceil(len(used) / _MEASURED_VIEWS)], backend):
        figures.append(psnr(image, target, valid))
        worse += figures[-1] < psnr(mean_color(target, valid), target, valid)
    mean = float(np.mean([min(figure, 99.0) for figure in figures]))
    if 2 * worse > len(figures):
        raise InvalidInputError(
            f"the photos do not show the splat from their poses: PSNR {mean:.1f} dB over {len(figures)} of them, less "
            "than their mean colors have",
            field="poses",
            hint="Send the poses in the world of the splat: those that it was trained with; for a splat of nerfstudio "
            "add its dataparser_transforms.json. Or send the splat alone.",
        )
    return {"psnr": mean}
