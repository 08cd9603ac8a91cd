"""Refits labels after color and geometry are final.

Codes trained through pixels alone leave the label of a single Gaussian open, above all where it hardly shows. Gaussians
whose code contradicts their label evidence get that label's mean code; then a few epochs fit all codes to pixels and to
those labels. Large Gaussians are held to their label less: areas seen by few views are drawn by large Gaussians that
other views show as something else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.scene.artefact.scene import F32, Evidence, Gaussians, SemanticHead
from fastsplat.service.scene.objects.label_evidence import posterior, seen_pixels
from fastsplat.service.splatting.gaussians import activate_opacities, current_gaussians, splats_of
from fastsplat.service.splatting.labels.semantics import (
    class_weights,
    code_size,
    label_loss,
    separated_codes,
    start_head,
)
from fastsplat.service.splatting.labels.view_evidence import views_evidence
from fastsplat.service.splatting.optim import adam_update
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend, Splats
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat.service.splatting.state import SplatState
from fastsplat.service.splatting.training_views import TrainingView
from fastsplat_contract.geometry.camera import Camera

_CODE_RATE = 0.1
_HEAD_RATE = 0.05
_FINAL_SHARE = 0.1
_CONSENSUS_WEIGHT = 0.3  # of the Gaussians' own cross-entropy relative to that of pixels
_HALF_HELD, _LEFT = 1.65, 3.3
"""Multiples of the mean Gaussian's pixels: own label at half weight; code not reset."""
_SEED = 7


def refit_codes(
    state: SplatState,
    views: Sequence[TrainingView],
    class_codes: Tensor,  # [N + 1, D], for labels with which no code agrees
    class_weights: Tensor,  # [N + 1], pixel weights of the cross-entropy
    *,
    undetected_weight: float,  # evidence weight of class-0 pixels
    epochs: int,  # more sharpen borders in renderings
    seed: int,  # of the view order
    backend: Backend,
) -> None:
    """Fits codes, weight and bias of `state` to the views' label maps, in place.

    A Gaussian's label is the most probable one by `views_evidence`. Where its code differs, it starts from
    `consensus_codes`, unless it fills at least 3.3 times the pixels of the mean Gaussian. Then `fit_codes` fits all
    codes at the training size. Without any label map nothing changes.
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
    """A view's label map."""

    viewmat: Tensor  # [4, 4], camera-from-world
    camera: Camera
    labels: Tensor  # integers [H, W]
    valid: Tensor | None  # bool [H, W], pixels that count; None means all


def fit_codes(
    splats: Splats,  # features are ignored
    views: Sequence[LabeledView],  # one per step, in epochs shuffled by `seed`
    starts: Mapping[str, Tensor],  # codes [G, D], weight [C, D] and bias [C]; not modified
    classes: Tensor,  # int64 [G], each Gaussian's own class
    pixels: Tensor,  # [G], filled by each Gaussian
    class_weights: Tensor,  # [C], pixel weights of the cross-entropy
    *,
    steps: int,
    seed: int,
    backend: Backend,
    after_step: Callable[[int, float], None] = lambda step, loss: None,
) -> dict[str, Tensor]:
    """Fits codes, weight and bias to label maps with fixed color and geometry.

    Adam on the cross-entropy of pixels and, weighted by 0.3 · 1.65 / (1.65 + pixels / mean pixels), of the Gaussians'
    own classes. `after_step` gets step (from 1) and loss, and may raise to cancel.
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


def codes_from_labels(
    gaussians: Gaussians,
    views: Sequence[LabeledView],
    evidence: Evidence,  # whose pixels each Gaussian fills
    classes: NDArray[np.integer],  # [G], each Gaussian's own class
    count: int,  # classes, 0 (none) included
    *,
    size: Literal["auto"] | int,  # see `code_size`
    none_weight: float,  # pixel weight of class 0
    steps: int,
    seed: int,
    backend: Backend,
    after_step: Callable[[int, float], None] = lambda step, loss: None,
) -> tuple[F32, SemanticHead]:
    """Fits codes, float32 [G, D], and their head from nothing but classes, as `fit_codes`."""
    device = device_of(backend)
    class_codes = separated_codes(count, code_size(count - 1, size), seed)
    owner = torch.from_numpy(classes.astype(np.int64))
    weight, bias = start_head(class_codes)
    starts = {"codes": class_codes[owner], "weight": weight, "bias": bias}
    fitted = fit_codes(
        splats_of(gaussians, device=device),
        views,
        {name: value.to(device) for name, value in starts.items()},
        owner.to(device),
        torch.from_numpy(seen_pixels(evidence)).to(device),
        class_weights(count, none_weight).to(device),
        steps=steps,
        seed=seed,
        backend=backend,
        after_step=after_step,
    )
    arrays = {name: value.cpu().numpy() for name, value in fitted.items()}
    return arrays["codes"], SemanticHead(arrays["weight"], arrays["bias"])


def consensus_codes(
    codes: Tensor, weight: Tensor, bias: Tensor, classes: Tensor, opacities: Tensor, class_codes: Tensor
) -> Tensor:
    """Replaces codes [G, D] that disagree with `classes` by their class's mean code.

    Means are weighted by `opacities`; `class_codes` [N + 1, D] replace means of no codes.
    """
    agree = (codes @ weight.T + bias).argmax(dim=1) == classes
    weights = torch.where(agree, opacities, 0.0)
    mass = torch.zeros_like(bias).index_add_(0, classes, weights)
    total = torch.zeros_like(weight).index_add_(0, classes, codes * weights[:, None])
    means = torch.where(mass[:, None] > 0, total / mass[:, None], class_codes.to(codes.device))
    return torch.where(agree[:, None], codes, means[classes])


def gaussian_label_loss(parameters: Mapping[str, Tensor], classes: Tensor, weights: Tensor) -> Tensor:
    """Mean cross-entropy of the Gaussians' own codes, weighted by `weights` [G]."""
    logits = torch.addmm(parameters["bias"], parameters["codes"], parameters["weight"].T)
    entropies = torch.nn.functional.cross_entropy(logits, classes, reduction="none")
    return (weights * entropies).mean()
