"""The semantic side of training: how many numbers a code has, where codes and W start, what a class weighs."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from service.common.dictionary import UNDETECTED
from service.splatting.initial import F32, project
from service.splatting.views import TrainingView

_MAX_AUTO_SIZE = 13
_HEAD_SCALE = 6.0
_TRIPLES_UP_TO = 64
_STARTS, _STEPS = 4, 150


def code_size(labels: int, wanted: Literal["auto"] | int) -> int:
    """Numbers a Gaussian carries for its meaning; 0 for a scene without labels.

    A pixel on the edge between two things blends their codes, and with short codes the blend lands in the cell of a
    third ("ghost label"). For n classes (labels and undetected), optimised unit codes keep every pair's midpoint
    0.15 or more away from any third class from these sizes on: n = 3: 2, 5: 4, 9: 5, 12: 6, 18: 8, 25: 10, 33: 11.
    `min(n − 1, ⌊2√n⌋)` follows that; it stops at 13, which with colour fills 16 channels.
    """
    if labels == 0:
        return 0
    if wanted != "auto":
        return wanted
    classes = labels + 1
    return min(classes - 1, math.isqrt(4 * classes), _MAX_AUTO_SIZE)


def separated_codes(classes: int, size: int, seed: int) -> Tensor:
    """float32 [classes, size]: unit vectors such that no midpoint of two is nearer to a third than to the two.

    For a, b and any third c the margin is (1 + a·b) − (a·c + b·c); its soft minimum over all triples is maximised,
    or, beyond 64 classes, the soft maximum of a·b over pairs is minimised. The best of a few random starts.
    """
    generator = torch.Generator().manual_seed(seed)
    starts = [torch.randn(classes, size, generator=generator) for _ in range(_STARTS)]
    if classes == 1 or size == 0:
        return torch.nn.functional.normalize(starts[0], dim=1)
    return min((_spread(start) for start in starts), key=lambda found: found[0])[1]


def _spread(codes: Tensor) -> tuple[float, Tensor]:
    """The final crowding, and the codes [classes, size] that gradient descent reached from `codes`."""
    classes = len(codes)
    codes = codes.clone().requires_grad_()
    optimizer = torch.optim.Adam([codes], lr=0.05)
    first, second = torch.triu_indices(classes, classes, 1)
    pairs = torch.arange(len(first))
    third = torch.ones(len(first), classes, dtype=torch.bool)
    third[pairs, first] = third[pairs, second] = False
    loss = torch.zeros(())
    with torch.enable_grad():
        for _ in range(_STEPS):
            unit = torch.nn.functional.normalize(codes, dim=1)
            cosine = unit @ unit.T
            crowding = cosine[first, second]
            if 2 < classes <= _TRIPLES_UP_TO:
                ghost = cosine[first] + cosine[second] - (1 + crowding)[:, None]
                crowding = torch.cat([ghost[third], crowding - 1])
            loss = torch.logsumexp(30 * crowding, 0) / 30
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
    return loss.item(), torch.nn.functional.normalize(codes.detach(), dim=1)


def start_head(codes: Tensor) -> tuple[Tensor, Tensor]:
    """The affine map W before training: weight [N + 1, D] along the classes' codes, bias [N + 1] zero."""
    return codes * _HEAD_SCALE, torch.zeros(len(codes))


def start_codes(points: F32, views: tuple[TrainingView, ...], class_codes: Tensor) -> Tensor:
    """float32 [P, D]: each point starts on the code of the label that most views show at its projection.

    Occlusion is not tested; undetected counts only where no view shows a label. Held-out views have no say.
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
    """float32 [N + 1]: what a pixel of each class weighs in the cross-entropy (FAST-Splat's γ)."""
    weights = torch.ones(classes)
    weights[UNDETECTED] = undetected
    return weights


def ghost_share(codes: Tensor, opacities: Tensor, weight: Tensor, bias: Tensor) -> float:
    """Share of pairs of present labels between whose mean codes a third class wins, 0..1; 0 with fewer than 2.

    Args:
        codes: [G, D]. opacities: [G], weigh the mean. weight: [N + 1, D]. bias: [N + 1].
    """
    logits = codes @ weight.T + bias
    label = logits.argmax(dim=1)
    mass = torch.zeros(len(bias)).index_add_(0, label, opacities)
    total = torch.zeros(len(bias), codes.shape[1]).index_add_(0, label, codes * opacities[:, None])
    present = torch.nonzero((mass > 0) & (torch.arange(len(bias)) != UNDETECTED))[:, 0]
    if len(present) < 2:
        return 0.0
    means = total[present] / mass[present, None]
    first, second = torch.triu_indices(len(present), len(present), 1)
    ghosts = torch.zeros(len(first), dtype=torch.bool)
    for share in torch.linspace(0.05, 0.95, 19):
        blend = means[first] * (1 - share) + means[second] * share
        winner = (blend @ weight.T + bias).argmax(dim=1)
        ghosts |= (winner != present[first]) & (winner != present[second])
    return float(ghosts.float().mean())
