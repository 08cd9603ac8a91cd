"""Groups of regions of several views that cover the same Gaussians, without a full matrix of regions × regions or ×
Gaussians: in memory are entries for what overlaps, and one number for each Gaussian or region and view."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array

from fastsplat.service.splatting.raster.types import LabelSums

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_SEEN_PX = 0.05
_INSIDE = 0.5
_ENOUGH = 0.3
"""Share of a region's Gaussians that another view must see before it can agree or disagree."""
_LEAST = 0.1
"""Smaller overlaps count as none."""
_ROWS = 64
"""Regions whose overlaps are computed at a time: about 60 bytes for each other that shares a Gaussian."""


@dataclass(frozen=True)
class LiftedRegions:
    """The R regions of one view as sets of the Gaussians more than half of whose weight in the view lies in the region.

    Attributes:
        starts: int64 [R + 1]; region r + 1 has the entries starts[r]..starts[r + 1] of `rows`.
        rows: int32, Gaussian ids, ascending within a region.
        pixels: float32 [G]: weight of each Gaussian in the view.
    """

    starts: I64
    rows: NDArray[np.int32]
    pixels: F32

    def __len__(self) -> int:
        return len(self.starts) - 1


def lift_regions(sums: LabelSums, members: csr_array) -> LiftedRegions:
    """Regions that may overlap, from the weight of each Gaussian by piece of the image.

    Args:
        sums: of a view, by piece; pieces do not overlap.
        members: CSR [A, R], 1 where a piece belongs to a region.
    """
    gaussians = len(sums.starts) - 1
    starts, pieces, weights = sums.starts.numpy(), sums.labels.numpy(), sums.sums.numpy()
    pixels = np.bincount(np.repeat(np.arange(gaussians), np.diff(starts)), weights, gaussians).astype(np.float32)
    in_region = (csr_array((weights, pieces, starts), shape=(gaussians, members.shape[0])) @ members).tocsr()
    in_region.sort_indices()
    rows = np.repeat(np.arange(gaussians), np.diff(in_region.indptr))
    regions = in_region.indices
    inside = (in_region.data > _INSIDE * pixels[rows]) & (pixels > _SEEN_PX)[rows]
    order = np.argsort(regions[inside], kind="stable")
    sizes = np.bincount(regions[inside], minlength=members.shape[1]).astype(np.int64)
    return LiftedRegions(np.concatenate([[0], np.cumsum(sizes)]), rows[inside][order].astype(np.int32), pixels)


def greedy_groups(overlaps: Overlaps, priority: F64, min_overlap: float) -> list[I64]:
    """Groups of regions as ascending rows, every region in one: the free region of highest priority starts a group, and
    those whose mean overlap with the group's exceeds `min_overlap` join it."""
    pairs = overlaps.pairs
    free, groups = np.ones(len(priority), np.bool_), []
    for first in np.argsort(-priority, kind="stable").tolist():
        if not free[first]:
            continue
        members = _above(pairs[[first]], free, min_overlap)
        joined = _above(pairs[members], free, min_overlap)
        members = joined if first in joined else members
        free[members] = False
        groups.append(members)
    return groups


def _above(rows: csr_array, free: NDArray[np.bool_], min_overlap: float) -> I64:
    mean = np.bincount(rows.indices, rows.data, rows.shape[1]) / rows.shape[0]
    return np.flatnonzero(free & (mean > min_overlap))


@dataclass(frozen=True)
class Overlaps:
    """Overlaps of P regions of V views on G Gaussians, see `overlaps_of`.

    Attributes:
        weights: CSR float32 [P, G]: the pixels that a Gaussian of the region fills.
        pairs: CSR float64 [P, P]: intersection over union of two regions by what both views see, 1 of a region with
            itself; without those below a tenth, and those of which one view sees too little of the other's region to
            tell.
        whole: [P]: weight of a region's Gaussians.
        owner: [P]: the region's view.
        visible: bool [V, G]: which Gaussians a view sees.
        size: float32 [G]: the pixels that each Gaussian fills, mean over the views.
    """

    weights: csr_array
    pairs: csr_array
    whole: F32
    owner: I64
    visible: NDArray[np.bool_]
    size: F32

    def agreement(self, min_overlap: float) -> F64:
        """[P]: sum over views of the largest overlap above `min_overlap` with one of the view's regions."""
        rows = np.repeat(np.arange(len(self.owner)), np.diff(self.pairs.indptr))
        over = self.pairs.data > min_overlap
        best = np.zeros((len(self.owner), len(self.visible)))
        np.maximum.at(best, (rows[over], self.owner[self.pairs.indices[over]]), self.pairs.data[over])
        result = np.zeros(len(self.owner))
        for of_view in best.T:  # one after the other: equal sums stay equal
            result += of_view
        return result


def overlaps_of(lifted: Iterable[LiftedRegions]) -> Overlaps:
    """The overlaps of the regions of at least one view, numbered in the views' order; consumed one at a time."""
    columns: list[NDArray[np.int32]] = []
    sizes: list[I64] = []
    visible: list[NDArray[np.bool_]] = []
    filled: F64 | None = None
    for view in lifted:
        filled = view.pixels.astype(np.float64) if filled is None else filled + view.pixels
        visible.append(view.pixels > _SEEN_PX)
        columns.append(view.rows)
        sizes.append(np.diff(view.starts))
    assert filled is not None
    size = (filled / len(sizes)).astype(np.float32)
    owner = np.repeat(np.arange(len(sizes)), [len(of_view) for of_view in sizes])
    gaussians = np.concatenate(columns)
    columns.clear()
    starts = np.concatenate([[0], np.cumsum(np.concatenate(sizes))])
    starts = starts.astype(np.int32 if starts[-1] < 1 << 31 else np.int64)  # int64 would widen the indices, too
    shape = (len(owner), len(size))
    inside_by_region = csr_array((np.ones(len(gaussians), np.float32), gaussians, starts), shape=shape)
    weights_by_region = csr_array((size[gaussians], gaussians, starts), shape=shape)
    seen = np.stack(visible)
    seen_by = np.concatenate(
        [weights_by_region @ seen[start : start + _ROWS].T.astype(np.float32) for start in range(0, len(seen), _ROWS)],
        axis=1,
    )
    whole = np.maximum(np.asarray(weights_by_region.sum(axis=1), np.float32), np.float32(1e-12))
    pairs = _pairs(weights_by_region, inside_by_region.T.tocsr(), seen_by, whole, owner)
    return Overlaps(weights_by_region, pairs, whole, owner, seen, size)


def _pairs(weights: csr_array, inside: csr_array, seen_by: F32, whole: F32, owner: I64) -> csr_array:
    count = len(owner)
    columns: list[NDArray[np.int32]] = []
    values: list[F64] = []
    sizes = np.zeros(count, np.int64)
    for start in range(0, count, _ROWS):
        common = weights[start : start + _ROWS] @ inside
        own, other = start + np.repeat(np.arange(common.shape[0]), np.diff(common.indptr)), common.indices
        here, there = seen_by[own, owner[other]], seen_by[other, owner[own]]
        enough = (here / whole[own] > _ENOUGH) & (there / whole[other] > _ENOUGH)
        overlap = np.where(enough, common.data / np.maximum(here + there - common.data, 1e-12), 0.0)
        kept = (overlap >= _LEAST) & (own != other)
        columns.append(other[kept])
        values.append(overlap[kept].astype(np.float64))
        sizes += np.bincount(own[kept], minlength=count)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    shape = (count, count)
    others = csr_array(
        (np.concatenate([*values, np.zeros(0)]), np.concatenate([*columns, np.zeros(0, np.int32)]), starts), shape=shape
    )
    return (others + eye_array(count, format="csr")).tocsr()


def one_piece_each(regions: int, sums: LabelSums) -> csr_array:
    """The `members` of `lift_regions` for regions that are pieces: region r is piece r + 1; others are outside all."""
    pieces = max(regions, int(sums.labels.max()) if len(sums.labels) else 0) + 1
    entries = (np.ones(regions), (np.arange(regions) + 1, np.arange(regions)))
    return csr_array(entries, shape=(pieces, regions))
