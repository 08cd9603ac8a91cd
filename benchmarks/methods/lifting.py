"""Labels and language features put onto trained Gaussians: without training, by blend weights; or by distillation.

`lift_features` is the method of Occam's LGS (Cheng et al. 2024) with the weights of all pixels in place of the one at a
Gaussian's center; `majority_labels` that of FlashSplat (Shen et al. 2024); `distill_features` the feature field of
Feature 3DGS (Zhou et al. 2024) on Gaussians that stay as they are, so that their pictures do.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from fastsplat.service.scene.types import F32, Gaussians
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.rendering import accumulate_weights, label_sums, rasterize
from fastsplat.service.splatting.training_views import Frame, TrainingView

_CHUNK = 64
"""Channels of one pass: [H, W, 64] floats are 44 MB at 480 × 360."""
_FEATURE_RATE, _FINAL_SHARE = 5e-2, 0.1
_TINY = 1e-12


def lift_features(gaussians: Gaussians, views: Sequence[TrainingView], labels: F32) -> Tensor:
    """float32 [G, E]: the mean over all labelled pixels of the vectors of their labels, by blend weight; zeros for a
    Gaussian that no labelled pixel shows.

    Args:
        gaussians: G of them.
        views: with label maps of ids 0..N at their last size; pixels of id 0, or not valid, say nothing.
        labels: float32 [N, E], vectors of the labels.
    """
    splats, table = splats_of(gaussians), torch.cat([torch.zeros(1, labels.shape[1]), torch.from_numpy(labels)])
    table = torch.cat([table, (torch.arange(len(table)) > 0).float()[:, None]], dim=1)  # a last channel counts
    sums = torch.zeros(len(gaussians), table.shape[1])
    for view in views:
        ids = _ids(view.frames[-1])
        for start in range(0, table.shape[1], _CHUNK):
            part = slice(start, start + _CHUNK)
            values = table[:, part][ids].contiguous()
            sums[:, part] += accumulate_weights(splats, view.viewmat, view.frames[-1].camera, values).float()
    return sums[:, :-1] / sums[:, -1:].clamp_min(_TINY)


def majority_labels(gaussians: Gaussians, views: Sequence[TrainingView], labels: int) -> Tensor:
    """int64 [G]: the label with the largest blend weight over all labelled pixels, the lower id of equals; 0 for a
    Gaussian that no labelled pixel shows. Arguments as `lift_features`, with the number of labels N."""
    splats, votes = splats_of(gaussians), torch.zeros(len(gaussians), labels + 1, dtype=torch.float64)
    for view in views:
        frame = view.frames[-1]
        sums = label_sums(splats, view.viewmat, frame.camera, _ids(frame).to(torch.int32), labels + 1)
        votes += sums.dense(labels + 1)
    votes[:, 0] = 0
    return torch.where(votes.sum(dim=1) > 0, votes.argmax(dim=1), 0)


def distill_features(
    gaussians: Gaussians, views: Sequence[TrainingView], labels: F32, *, size: int, steps: int, seed: int = 0
) -> tuple[Tensor, Tensor]:
    """Features float32 [G, D] and a linear decoder [D, E] whose decoded pictures are the vectors of the pixels' labels.

    The loss is the mean absolute difference over labelled pixels, as Feature 3DGS has it. Two things differ from it:
    means, shapes and opacities stay as they are, and the decoder is not trained with the features, but has the
    principal directions of the labels' vectors from the start, so that the comparison is in D numbers a pixel.

    Args:
        gaussians, views, labels: as `lift_features`.
        size: D, at most E.
        steps: of Adam, one view each, in random order.
        seed: of the order.
    """
    generator = torch.Generator().manual_seed(seed)
    decoder = torch.from_numpy(labels).new_zeros(size, labels.shape[1])
    directions = torch.linalg.svd(torch.from_numpy(labels), full_matrices=False).Vh[:size]
    decoder[: len(directions)] = directions
    targets = torch.cat([torch.zeros(1, size), torch.from_numpy(labels) @ decoder.T])
    features = torch.zeros(len(gaussians), size, requires_grad=True)
    # A Gaussian's gradient is a share of a pixel's, which Adam's usual epsilon would drown.
    optimizer = torch.optim.Adam([features], lr=_FEATURE_RATE, eps=1e-15)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, _FINAL_SHARE ** (1 / max(1, steps)))
    order = torch.zeros(0, dtype=torch.int64)
    for step in range(steps):
        if step % len(views) == 0:
            order = torch.randperm(len(views), generator=generator)
        view = views[int(order[step % len(views)])]
        ids = _ids(view.frames[-1])
        drawn = rasterize(splats_of(gaussians, features), view.viewmat, view.frames[-1].camera).image
        loss = (drawn[ids > 0] - targets[ids[ids > 0]]).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return features.detach(), decoder


def _ids(frame: Frame) -> Tensor:
    """int64 [H, W], label ids, 0 where a pixel says nothing."""
    assert frame.labels is not None
    ids = frame.labels.long()
    return ids if frame.valid is None else torch.where(frame.valid, ids, 0)
