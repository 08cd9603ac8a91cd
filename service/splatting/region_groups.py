"""Groups of regions of several views that cover the same Gaussians, without a matrix of regions × regions or ×
Gaussians.

In memory are one entry for each Gaussian and each view that assigns it to a region (8 bytes, twice), and one number for
each Gaussian and view and for each region and view (4 bytes). Overlaps are computed for a few regions at a time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array  # type: ignore[import-untyped]

from fastsplat.service.splatting.raster.types import LabelSums

Region = tuple[int, int]
"""View and region number, 1 the first."""

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_SEEN_PX = 0.05
_INSIDE = 0.5
_ENOUGH = 0.3
"""Share of a region's Gaussians that another view must see before it can agree or disagree."""
_ROWS = 64
"""Regions whose overlaps are computed at a time; about 60 bytes for each other region that shares a Gaussian."""


def group_regions(
    sums: Iterable[LabelSums], counts: Sequence[int], *, min_overlap: float = 0.5
) -> list[tuple[Region, ...]]:
    """Groups of regions that cover the same Gaussians, those with most agreement first; every region is in one.

    Two regions overlap by the intersection over union of the Gaussians more than half of whose weight in the view lies
    in the region, among those that both views see; Gaussians count by the pixels that they fill. The region that most
    views agree with starts a group; regions whose mean overlap with the group's exceeds `min_overlap` join it.

    Args:
        sums: of each view, the weight of each Gaussian by region, 0 = outside all. Consumed one at a time.
        counts: regions of each view.
        min_overlap: 0..1.
    """
    if not sum(counts):
        return []
    overlaps = _overlaps(sums, counts)
    agreement = overlaps.agreement(min_overlap)
    regions = [(view, region) for view, count in enumerate(counts) for region in range(1, count + 1)]
    free, groups = np.ones(len(regions), np.bool_), []
    while free.any():
        first = np.array([np.argmax(np.where(free, agreement, -1.0))])
        members = np.flatnonzero(free & (overlaps.mean_with(first) > min_overlap))
        joined = np.flatnonzero(free & (overlaps.mean_with(members) > min_overlap))
        members = joined if first[0] in joined else members
        free[members] = False
        groups.append(tuple(regions[row] for row in members))
    return groups


@dataclass(frozen=True)
class _Overlaps:
    """Overlaps of P regions of V views on G Gaussians.

    Attributes:
        weights: CSR float32 [P, G]: the pixels that a Gaussian of the region fills.
        inside: CSR float32 [G, P], 1 where the Gaussian belongs to the region.
        seen_by: [P, V]: weight of a region's Gaussians that a view sees.
        whole: [P]: weight of a region's Gaussians.
        owner: [P]: the region's view.
    """

    weights: csr_array
    inside: csr_array
    seen_by: F32
    whole: F32
    owner: I64

    def mean_with(self, rows: I64) -> F64:
        """[P]: mean overlap of each region with those in `rows`."""
        total = np.zeros(len(self.owner))
        for piece in self._pieces(rows):
            total += np.bincount(piece.columns, piece.overlap, len(total))
            total[piece.rows] += 1.0  # with itself
        return total / len(rows)

    def agreement(self, min_overlap: float) -> F64:
        """[P]: sum over views of the largest overlap above `min_overlap` with one of the view's regions."""
        result = np.zeros(len(self.owner))
        for piece in self._pieces(np.arange(len(self.owner))):
            best = np.zeros((len(piece.rows), self.seen_by.shape[1]))
            best[np.arange(len(piece.rows)), self.owner[piece.rows]] = 1.0  # with itself
            over = piece.overlap > min_overlap
            np.maximum.at(best, (piece.places[over], self.owner[piece.columns[over]]), piece.overlap[over])
            for of_view in best.T:  # one after the other: equal sums stay equal
                result[piece.rows] += of_view
        return result

    def _pieces(self, rows: I64) -> Iterator[_Piece]:
        for start in range(0, len(rows), _ROWS):
            some = rows[start : start + _ROWS]
            common = self.weights[some] @ self.inside
            places = np.repeat(np.arange(len(some)), np.diff(common.indptr))
            others = some[places] != common.indices
            places, columns, shared = places[others], common.indices[others], common.data[others]
            own = some[places]
            here, there = self.seen_by[own, self.owner[columns]], self.seen_by[columns, self.owner[own]]
            enough = (here / self.whole[own] > _ENOUGH) & (there / self.whole[columns] > _ENOUGH)
            overlap = np.where(enough, shared / np.maximum(here + there - shared, 1e-12), 0.0)
            yield _Piece(some, places, columns, overlap.astype(np.float64))


@dataclass(frozen=True)
class _Piece:
    """Overlaps of a few regions with all others that they share Gaussians with.

    Attributes:
        rows: the few regions.
        places: of each overlap, index into `rows`.
        columns: of each overlap, the other region. Regions of one view share none.
        overlap: 0 where one view sees too little of the other's region to tell.
    """

    rows: I64
    places: I64
    columns: NDArray[np.int32]
    overlap: F64


def _overlaps(sums: Iterable[LabelSums], counts: Sequence[int]) -> _Overlaps:
    owner = np.repeat(np.arange(len(counts)), counts)
    indices: list[NDArray[np.int32]] = []
    sizes: list[I64] = []
    visible: list[NDArray[np.bool_]] = []
    filled: F64 | None = None
    for view_sums, count in zip(sums, counts, strict=True):
        gaussians = len(view_sums.starts) - 1
        rows = np.repeat(np.arange(gaussians), np.diff(view_sums.starts.numpy()))
        labels, weights = view_sums.labels.numpy(), view_sums.sums.numpy()
        pixels = np.bincount(rows, weights, gaussians).astype(np.float32)
        filled = pixels.astype(np.float64) if filled is None else filled + pixels
        visible.append(pixels > _SEEN_PX)
        inside = (weights > _INSIDE * pixels[rows]) & (labels >= 1) & (labels <= count) & visible[-1][rows]
        order = np.argsort(labels[inside], kind="stable")
        indices.append(rows[inside][order].astype(np.int32))
        sizes.append(np.bincount(labels[inside], minlength=count + 1)[1:].astype(np.int64))
    assert filled is not None
    size = (filled / len(counts)).astype(np.float32)
    columns = np.concatenate(indices)
    starts = np.concatenate([[0], np.cumsum(np.concatenate(sizes))])
    shape = (len(owner), len(size))
    inside_by_region = csr_array((np.ones(len(columns), np.float32), columns, starts), shape=shape)
    weights_by_region = csr_array((size[columns], columns, starts), shape=shape)
    seen_by = weights_by_region @ np.stack(visible).T.astype(np.float32)
    whole = np.maximum(np.asarray(weights_by_region.sum(axis=1), np.float32), np.float32(1e-12))
    return _Overlaps(weights_by_region, inside_by_region.T.tocsr(), seen_by, whole, owner)
