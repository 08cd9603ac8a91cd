"""Labels fitted once more when color and geometry are final.

Codes that are trained through pixels alone leave the label of a single Gaussian open, above all where it hardly shows.
Here Gaussians whose code contradicts the label that the label maps say get that label's mean code; then a few looks at
every view fit all codes to pixels and to those labels at once. Large Gaussians are held to one label less: what few
views show is drawn by large ones that other views show as something else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from fastsplat.service.scene.label_evidence import posterior, seen_pixels
from fastsplat.service.splatting.gaussians import activate_opacities, current_gaussians, splats_of
from fastsplat.service.splatting.optim import adam_update
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat.service.splatting.raster.types import Backend, Splats
from fastsplat.service.splatting.semantics import label_loss
from fastsplat.service.splatting.state import SplatState
from fastsplat.service.splatting.training_views import TrainingView
from fastsplat.service.splatting.view_evidence import views_evidence
from fastsplat_contract.camera import Camera

_CODE_RATE = 0.1
_HEAD_RATE = 0.05
_FINAL_SHARE = 0.1
_CONSENSUS_WEIGHT = 0.3
"""Of the mean cross-entropy of Gaussians' own labels, beside that of pixels."""
_HALF_HELD, _LEFT = 1.65, 3.3
"""Times the pixels of the mean Gaussian at which one's own label weighs half, and from which its code stays."""
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

    A Gaussian's label is the most probable one by evidence (`views_evidence`). Where its code says another, it starts
    on the mean code of those that agree (`consensus_codes`), unless it fills 3.3 times as many pixels as the mean
    Gaussian. Then all codes are fitted, see `fit_codes`, at the training size.

    Args:
        state: of a finished run, G Gaussians.
        views: the training views; those without a label map are left out, and without any nothing changes.
        class_codes: [N + 1, D], for labels with which no code agrees.
        class_weights: [N + 1], what pixels weigh in the cross-entropy; as evidence, those of class 0 weigh
            `undetected_weight`.
        epochs: more sharpen the borders in pictures.
    """
    maps = [view.frames[-1].labels for view in views]
    labeled = [(view, labels) for view, labels in zip(views, maps, strict=True) if labels is not None]
    if not labeled or not class_codes.shape[1] or not state.count:
        return
    gaussians = current_gaussians(state.parameters)
    evidence = views_evidence(
        gaussians, [view for view, _ in labeled], len(class_codes), undetected_weight=undetected_weight, backend=backend
    )
    classes = torch.from_numpy(posterior(evidence, len(class_codes)).classes.astype(np.int64))
    classes = classes.to(state.parameters["codes"].device)
    starts = {name: state.parameters[name].detach() for name in ("codes", "weight", "bias")}
    opacities = activate_opacities(state.parameters["logit_opacities"].detach())
    pixels = torch.from_numpy(seen_pixels(evidence)).to(classes.device)
    agreed = consensus_codes(**starts, classes=classes, opacities=opacities, class_codes=class_codes)
    left = (pixels / pixels.mean().clamp_min(1e-9) < _LEFT)[:, None]
    starts["codes"] = torch.where(left, agreed, starts["codes"])
    with torch.no_grad():
        splats = splats_of(state.parameters)
    fitted = fit_codes(
        splats,
        [LabeledView(view.viewmat, view.frames[-1].camera, labels, view.frames[-1].valid) for view, labels in labeled],
        starts,
        classes,
        pixels,
        class_weights,
        steps=epochs * len(labeled),
        seed=seed,
        backend=backend,
    )
    for name, value in fitted.items():
        state.parameters[name].data.copy_(value)


class LabeledView(NamedTuple):
    """One view's label map: camera from world, float32 [4, 4], integers [H, W], and which pixels say anything, bool
    [H, W], or None for all."""

    viewmat: Tensor
    camera: Camera
    labels: Tensor
    valid: Tensor | None


def fit_codes(
    splats: Splats,
    views: Sequence[LabeledView],
    starts: Mapping[str, Tensor],
    classes: Tensor,
    pixels: Tensor,
    class_weights: Tensor,
    *,
    steps: int,
    seed: int,
    backend: Backend,
    after_step: Callable[[int, float], None] = lambda step, loss: None,
) -> dict[str, Tensor]:
    """Codes, weight and bias fitted to label maps, color and geometry held: Adam on the cross-entropy of pixels and,
    weighted by 0.3 · 1.65 / (1.65 + pixels / mean pixels), of the Gaussians' own classes.

    Args:
        splats: G activated Gaussians; features are not read.
        views: looked at one a step, all once before any one again, in orders drawn from `seed`.
        starts: codes [G, D], weight [C, D] and bias [C]; they are not changed.
        classes, pixels: [G], each Gaussian's own class, int64, 0..C − 1, and how many pixels it fills, float32.
        class_weights: [C], what pixels weigh in the cross-entropy.
        after_step: called with the number of each step, from 1, and its loss; may raise, as to cancel.
    """
    shares = _HALF_HELD / (_HALF_HELD + pixels / pixels.mean().clamp_min(1e-9))
    fitted = {name: value.clone().contiguous().requires_grad_() for name, value in starts.items()}
    moments = {name: (torch.zeros_like(value), torch.zeros_like(value)) for name, value in fitted.items()}
    for step in range(steps):
        epoch, position = divmod(step, len(views))
        order = np.random.default_rng((seed, _SEED, epoch)).permutation(len(views))
        view = views[int(order[position])]
        image = rasterize(replace(splats, features=fitted["codes"]), view.viewmat, view.camera, backend=backend).image
        loss = label_loss(image, fitted, view.labels, view.valid, class_weights)
        loss = loss + _CONSENSUS_WEIGHT * gaussian_label_loss(fitted, classes, shares)
        loss.backward()
        decay = _FINAL_SHARE ** (step / steps)
        for name, param in fitted.items():
            rate = decay * (_CODE_RATE if name == "codes" else _HEAD_RATE)
            assert param.grad is not None
            adam_update(param, param.grad, *moments[name], lr=rate, step=step + 1, backend=backend)
            param.grad = None
        after_step(step + 1, float(loss.detach()))
    return {name: value.detach() for name, value in fitted.items()}


def consensus_codes(
    codes: Tensor, weight: Tensor, bias: Tensor, classes: Tensor, opacities: Tensor, class_codes: Tensor
) -> Tensor:
    """[G, D]: the codes, those that say another class than `classes` replaced by the mean code of it.

    Args:
        codes: [G, D]. weight: [N + 1, D]. bias: [N + 1].
        classes: int64 [G], 0..N.
        opacities: [G], weigh the means.
        class_codes: [N + 1, D], in place of means of nothing.
    """
    agree = (codes @ weight.T + bias).argmax(dim=1) == classes
    weights = torch.where(agree, opacities, 0.0)
    mass = torch.zeros_like(bias).index_add_(0, classes, weights)
    total = torch.zeros_like(weight).index_add_(0, classes, codes * weights[:, None])
    means = torch.where(mass[:, None] > 0, total / mass[:, None], class_codes.to(codes.device))
    return torch.where(agree[:, None], codes, means[classes])


def gaussian_label_loss(parameters: Mapping[str, Tensor], classes: Tensor, weights: Tensor) -> Tensor:
    """Mean of the cross-entropies of the Gaussians' own codes [G, D], weighted by float32 [G], with int64 classes [G],
    0..N, under weight [N + 1, D] and bias [N + 1]."""
    logits = torch.addmm(parameters["bias"], parameters["codes"], parameters["weight"].T)
    entropies = torch.nn.functional.cross_entropy(logits, classes, reduction="none")
    return (weights * entropies).mean()
