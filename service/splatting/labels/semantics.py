"""Semantic codes in training: size, initialization, class weights and loss."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.common.dictionary import UNDETECTED
from fastsplat.service.scene.artefact.scene import SemanticHead
from fastsplat.service.splatting.gaussians import activate_opacities
from fastsplat.service.splatting.initial import F32, project
from fastsplat.service.splatting.losses.functional import semantic_loss
from fastsplat.service.splatting.training_views import TrainingView

_MAX_AUTO_SIZE = 13
_HEAD_SCALE = 6.0
_TRIPLES_UP_TO, _PAIRS_UP_TO = 64, 512
_GHOST_PAIRS = 2_000
_STARTS, _STEPS = 6, 100


def code_size(labels: int, setting: Literal["auto"] | int) -> int:
    """Returns the code dimension; 0 for a scene without labels.

    With short codes the blend of two objects may be classified as a third ("ghost label"). `min(n − 1, ⌊2√n⌋)` keeps
    every pair's midpoint 0.15 or more away from any third of n classes. The limit 13 fills 16 channels together with
    color.
    """
    if labels == 0:
        return 0
    if setting != "auto":
        return setting
    classes = labels + 1
    return min(classes - 1, math.isqrt(4 * classes), _MAX_AUTO_SIZE)


def separated_codes(classes: int, size: int, seed: int) -> Tensor:
    """Returns unit vectors [classes, size] whose pairs' midpoints are far from third ones.

    Maximizes the margin (1 + a·b) − (a·c + b·c) over triples; beyond 64 classes minimizes a·b over pairs; beyond 512
    takes a random start.
    """
    random = np.random.default_rng((seed, 5))
    starts = [random.normal(size=(classes, size)) for _ in range(_STARTS if classes <= _TRIPLES_UP_TO // 2 else 1)]
    if classes == 1 or size == 0 or classes > _PAIRS_UP_TO:
        codes = starts[0] / np.maximum(np.linalg.norm(starts[0], axis=1, keepdims=True), 1e-12)
    else:
        codes = min((_spread(start) for start in starts), key=lambda result: result[0])[1]
    return torch.from_numpy(codes.astype(np.float32))


def _spread(codes: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Gradient descent on the sphere; returns the final worst crowding and unit vectors."""
    same = np.eye(len(codes), dtype=np.bool_)
    triples = 2 < len(codes) <= _TRIPLES_UP_TO
    excluded = same[:, None, :] | same[None, :, :] | same[:, :, None] if triples else same
    worst = 0.0
    for step in range(_STEPS):
        codes = codes / np.linalg.norm(codes, axis=1, keepdims=True)
        cosine = codes @ codes.T
        crowding = cosine[:, None, :] + cosine[None, :, :] - (1 + cosine[:, :, None]) if triples else cosine
        crowding = np.where(excluded, -np.inf, crowding)
        worst = float(crowding.max())
        share = np.exp(30 * (crowding - worst))
        share /= share.sum()
        to_cosine = share.sum(axis=1) + share.sum(axis=0) - share.sum(axis=2) if triples else share
        gradient = (to_cosine + to_cosine.T) @ codes
        gradient -= (gradient * codes).sum(axis=1, keepdims=True) * codes
        codes = codes - 0.3 * (1 - step / _STEPS) * gradient / max(float(np.abs(gradient).max()), 1e-12)
    return worst, codes / np.linalg.norm(codes, axis=1, keepdims=True)


def start_head(codes: Tensor) -> tuple[Tensor, Tensor]:
    """Initializes W along the class codes, [N + 1, D], and a zero bias."""
    return codes * _HEAD_SCALE, torch.zeros(len(codes))


def start_codes(points: F32, views: tuple[TrainingView, ...], class_codes: Tensor) -> Tensor:
    """Initializes codes [P, D] by majority vote of the labels at the points' projections.

    Occlusion is not tested; undetected wins only without any label. `views` must not include held-out ones.
    """
    votes = np.zeros((len(points), len(class_codes)), np.int32)
    for view in views:
        labels = view.frames[-1].labels
        if labels is None:
            continue
        pixels, inside = project(points, view)
        rows = np.flatnonzero(inside)
        np.add.at(votes, (rows, labels.numpy()[pixels[rows, 0], pixels[rows, 1]]), 1)
    votes[:, UNDETECTED] = 0
    winner: NDArray[np.int64] = votes.argmax(axis=1)
    return class_codes[torch.from_numpy(winner)].clone()


def class_weights(classes: int, undetected: float) -> Tensor:
    """Returns pixel weights of the cross-entropy (FAST-Splat's γ), float32 [N + 1]."""
    weights = torch.ones(classes)
    weights[UNDETECTED] = undetected
    return weights


def label_loss(
    codes: Tensor, parameters: Mapping[str, Tensor], labels: Tensor, valid: Tensor | None, class_weights: Tensor
) -> Tensor:
    """Computes the weighted cross-entropy over valid pixels."""
    weight, bias = parameters["weight"], parameters["bias"]
    if valid is not None:  # invalid pixels get an extra class of weight 0 that no code can reach
        labels = torch.where(valid, labels.to(torch.int32), len(bias))
        weight = torch.cat([weight, weight.new_zeros(1, weight.shape[1])])
        bias = torch.cat([bias, bias.new_full((1,), -1e30)])
        class_weights = torch.cat([class_weights, class_weights.new_zeros(1)])
    return semantic_loss(codes, weight, bias, labels, class_weights)


def ghost_share(stored_codes: F32, logit_opacities: F32, head: SemanticHead) -> float:
    """Share of label pairs between whose mean codes, weighted by opacity, a third class wins, 0..1.

    Tests at most 2,000 pairs of present labels; 0 with fewer than 2 labels.
    """
    codes, weight, bias = (torch.from_numpy(array) for array in (stored_codes, head.weight, head.bias))
    opacities = activate_opacities(torch.from_numpy(logit_opacities))
    logits = codes @ weight.T + bias
    label = logits.argmax(dim=1)
    mass = torch.zeros(len(bias)).index_add_(0, label, opacities)
    total = torch.zeros(len(bias), codes.shape[1]).index_add_(0, label, codes * opacities[:, None])
    present = torch.nonzero((mass > 0) & (torch.arange(len(bias)) != UNDETECTED))[:, 0]
    if len(present) < 2:
        return 0.0
    means = total[present] / mass[present, None]
    first, second = torch.triu_indices(len(present), len(present), 1)
    if len(first) > _GHOST_PAIRS:
        some = torch.randperm(len(first), generator=torch.Generator().manual_seed(0))[:_GHOST_PAIRS]
        first, second = first[some], second[some]
    ghosts = torch.zeros(len(first), dtype=torch.bool)
    for share in torch.linspace(0.05, 0.95, 19):
        blend = means[first] * (1 - share) + means[second] * share
        winner = (blend @ weight.T + bias).argmax(dim=1)
        ghosts |= (winner != present[first]) & (winner != present[second])
    return float(ghosts.float().mean())
