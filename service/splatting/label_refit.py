"""Labels fitted once more when color and geometry are final.

Codes that are trained together with moving Gaussians lag behind them, and those of Gaussians that hardly show drift
wherever Adam's normalized steps lead; so the label of a single Gaussian is less sure than what a pixel blends. Here
every Gaussian starts on the code of the label that the label maps say it has, and a few looks at every view sharpen the
borders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from fastsplat.service.scene.label_evidence import posterior
from fastsplat.service.splatting.gaussians import current_gaussians, splats_of
from fastsplat.service.splatting.optim import adam_update
from fastsplat.service.splatting.raster import Backend, rasterize
from fastsplat.service.splatting.semantics import label_loss, start_head
from fastsplat.service.splatting.state import SplatState
from fastsplat.service.splatting.training_views import TrainingView
from fastsplat.service.splatting.view_evidence import views_evidence

_CODE_RATE = 0.1
_HEAD_RATE = 0.05
_EPS_PIXELS = 1.7
"""Adam's epsilon, in pixels: a Gaussian that shows less than about so much in a view hardly moves from its evidence."""
_FINAL_SHARE = 0.3
_SEED = 7


def refit_codes(
    state: SplatState,
    views: Sequence[TrainingView],
    class_codes: Tensor,
    class_weights: Tensor,
    *,
    undetected_weight: float,
    epochs: int,
    seed: int,
    backend: Backend,
) -> None:
    """Replaces codes, weight and bias of `state` by ones fitted to the views' label maps; nothing else changes.

    Each Gaussian starts on the code of its most probable label by evidence (`views_evidence`), the head on
    `class_codes`; then every labeled view is looked at `epochs` times, in an order drawn from `seed`, at the training
    size.

    Args:
        state: of a finished run, G Gaussians.
        views: the training views; those without a label map are left out, and without any nothing changes.
        class_codes: [N + 1, D].
        class_weights: [N + 1], what pixels weigh in the cross-entropy.
        undetected_weight: what a pixel of class 0 weighs as evidence.
        epochs: more sharpen the borders in pictures and blur single Gaussians' labels.
        seed: of the order of the views.
        backend: which rasterizer.
    """
    labeled = [view for view in views if view.frames[-1].labels is not None]
    if not labeled or not class_codes.shape[1] or not state.count:
        return
    gaussians = current_gaussians(state.parameters)
    evidence = views_evidence(
        gaussians, labeled, len(class_codes), undetected_weight=undetected_weight, backend=backend
    )
    classes = torch.from_numpy(posterior(evidence, len(class_codes)).classes.astype(np.int64))
    weight, bias = start_head(class_codes)
    device = state.parameters["codes"].device
    starts = {"codes": class_codes[classes].clone(), "weight": weight, "bias": bias}
    fitted = {name: value.to(device).contiguous().requires_grad_() for name, value in starts.items()}
    moments = {name: (torch.zeros_like(value), torch.zeros_like(value)) for name, value in fitted.items()}
    with torch.no_grad():
        splats = splats_of(state.parameters)
    steps = epochs * len(labeled)
    for step in range(steps):
        epoch, position = divmod(step, len(labeled))
        order = np.random.default_rng((seed, _SEED, epoch)).permutation(len(labeled))
        view = labeled[int(order[position])]
        frame = view.frames[-1]
        assert frame.labels is not None
        image = rasterize(replace(splats, features=fitted["codes"]), view.viewmat, frame.camera, backend=backend).image
        label_loss(image, fitted, frame.labels, frame.valid, class_weights).backward()  # type: ignore[no-untyped-call]
        eps = _EPS_PIXELS / (frame.camera.width * frame.camera.height)
        decay = _FINAL_SHARE ** (step / steps)
        for name, param in fitted.items():
            rate = decay * (_CODE_RATE if name == "codes" else _HEAD_RATE)
            assert param.grad is not None
            adam_update(param, param.grad, *moments[name], lr=rate, step=step + 1, eps=eps, backend=backend)
            param.grad = None
    for name, param in fitted.items():
        state.parameters[name].data.copy_(param.detach())
