"""Classifies rendered codes in plain torch, where no C++ kernel does."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from fastsplat.service.splatting.raster.image_formation import LabelMap, LabelSums, Rendering

LOGIT_LIMIT = 1e30
_CHUNK = 1 << 22
_LABELS = 16


class Head(NamedTuple):
    """What codes are classified with, see `rendering.label_map`."""

    weight: Tensor
    bias: Tensor
    relevancy: Tensor | None
    alpha_min: float


def label_map(rendering: Rendering, head: Head) -> LabelMap:
    """Classifies a rendering whose last D channels are codes, in its dtype."""
    height, width, channels = rendering.image.shape
    first = channels - head.weight.shape[1]
    codes = rendering.image[..., first:].reshape(height * width, -1)
    weight, bias = head.weight.to(codes), head.bias.to(codes)
    values = None if head.relevancy is None else head.relevancy.to(codes)
    classes = torch.zeros(len(codes), dtype=torch.int32, device=codes.device)
    expected = torch.zeros(len(codes), dtype=codes.dtype, device=codes.device)
    columns = max(1, _CHUNK // len(bias))
    for start in range(0, len(codes), columns):
        piece = slice(start, start + columns)
        # Classes as rows: reductions over the few classes then run along whole cache lines.
        logits = torch.addmm(bias[:, None], weight, codes[piece].T)
        logits = logits.nan_to_num(-LOGIT_LIMIT).clamp(-LOGIT_LIMIT, LOGIT_LIMIT)
        best, winner = logits.max(dim=0)
        classes[piece] = winner.to(torch.int32)
        if values is not None:
            shares = logits.sub_(best).exp_()
            expected[piece] = (values @ shares) / shares.sum(dim=0)
    class_map = torch.where(rendering.alpha >= head.alpha_min, classes.reshape(height, width), 0)
    found = None if values is None else expected.reshape(height, width)
    return LabelMap(class_map, rendering.alpha, found, rendering.image[..., :first], rendering.culled_non_finite)


def bands(rendering: Rendering, max_values: int) -> Iterator[tuple[slice, Rendering]]:
    """Splits a rendering into row bands of at most `max_values` image values each."""
    height, width, channels = rendering.image.shape
    rows = max(1, max_values // max(1, width * channels))
    for start in range(0, height, rows):
        band = slice(start, min(start + rows, height))
        median = None if rendering.median_depth is None else rendering.median_depth[band]
        image, alpha, depth = (part[band] for part in (rendering.image, rendering.alpha, rendering.depth))
        yield band, replace(rendering, image=image, alpha=alpha, depth=depth, median_depth=median)


def joined(maps: Sequence[LabelMap]) -> LabelMap:
    """Concatenates label maps vertically."""
    relevancies = [part.relevancy for part in maps if part.relevancy is not None]
    classes, alpha, image = (
        torch.cat([getattr(part, name) for part in maps]) for name in ("classes", "alpha", "image")
    )
    return LabelMap(classes, alpha, torch.cat(relevancies) if relevancies else None, image, maps[0].culled_non_finite)


def label_sums(labels: Tensor, gaussians: int, accumulate: Callable[[Tensor], Tensor]) -> LabelSums:
    """Sums weights per label with `accumulate` ([H, W, V] -> [G, V]) in small batches."""
    present = torch.unique(labels)
    present = present[present >= 0]
    rows, columns, values = [], [], []
    for start in range(0, len(present), _LABELS):
        some = present[start : start + _LABELS]
        sums = accumulate((labels[..., None] == some).float()).double()
        row, column = torch.nonzero(sums > 0, as_tuple=True)
        rows.append(row)
        columns.append(some[column])
        values.append(sums[row, column])
    nothing = torch.zeros(0, dtype=torch.int64, device=labels.device)
    row, column = torch.cat([nothing, *rows]), torch.cat([nothing, *columns])
    order = torch.argsort(row, stable=True)  # labels ascend already
    starts = torch.zeros(gaussians + 1, dtype=torch.int64, device=labels.device)
    starts[1:] = torch.bincount(row, minlength=gaussians).cumsum(0)
    return LabelSums(starts, column[order].to(torch.int32), torch.cat([nothing.double(), *values])[order])
