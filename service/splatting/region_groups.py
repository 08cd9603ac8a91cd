"""Groups of regions of several views that cover the same Gaussians, without a matrix of regions × regions or ×
Gaussians.

In memory are one entry for each Gaussian and each view that assigns it to a region (8 bytes, twice), and one number for
each Gaussian and view and for each region and view (4 bytes). Overlaps are computed for a few regions at a time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fastsplat.service.splatting.raster.types import LabelSums

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_SEEN_PX = 0.05
_INSIDE = 0.5
_ENOUGH = 0.3
"""Share of a region's Gaussians that another view must see before it can agree or disagree."""
_ROWS = 64
"""Regions whose overlaps are computed at a time; about 60 bytes for each other region that shares a Gaussian. As many
views at a time are asked which Gaussians they see: 4 bytes for each."""


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
    free, groups = np.ones(len(priority), np.bool_), []
    while free.any():
        first = np.array([np.argmax(np.where(free, priority, -1.0))])
        members = np.flatnonzero(free & (overlaps.mean_with(first) > min_overlap))
        joined = np.flatnonzero(free & (overlaps.mean_with(members) > min_overlap))
        members = joined if first[0] in joined else members
        free[members] = False
        groups.append(members)
    return groups


@dataclass(frozen=True)
class Overlaps:
    """Overlaps of P regions of V views on G Gaussians, see `overlaps_of`.

    Attributes:
        weights: CSR float32 [P, G]: the pixels that a Gaussian of the region fills.
        inside: CSR float32 [G, P], 1 where the Gaussian belongs to the region.
        seen_by: [P, V]: weight of a region's Gaussians that a view sees.
        whole: [P]: weight of a region's Gaussians.
        owner: [P]: the region's view.
        visible: bool [V, G]: which Gaussians a view sees.
        size: float32 [G]: the pixels that each Gaussian fills, mean over the views.
    """

    weights: csr_array
    inside: csr_array
    seen_by: F32
    whole: F32
    owner: I64
    visible: NDArray[np.bool_]
    size: F32

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
        columns: of each overlap, the other region.
        overlap: 0 where one view sees too little of the other's region to tell.
    """

    rows: I64
    places: I64
    columns: NDArray[np.int32]
    overlap: F64


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
    return Overlaps(weights_by_region, inside_by_region.T.tocsr(), seen_by, whole, owner, seen, size)


def one_piece_each(regions: int, sums: LabelSums) -> csr_array:
    """The `members` of `lift_regions` for regions that are pieces: region r is piece r + 1; others are outside all."""
    pieces = max(regions, int(sums.labels.max()) if len(sums.labels) else 0) + 1
    entries = (np.ones(regions), (np.arange(regions) + 1, np.arange(regions)))
    return csr_array(entries, shape=(pieces, regions))
