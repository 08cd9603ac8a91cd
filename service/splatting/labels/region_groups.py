"""Groups image regions of several views that cover the same Gaussians.

Sparse: memory holds entries for overlaps, and one number per Gaussian or region and view.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array

from fastsplat.service.splatting.raster.image_formation import LabelSums

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_SEEN_PX = 0.05
_INSIDE = 0.5
_ENOUGH = 0.3  # share of a region's Gaussians another view must see to be compared
_LEAST = 0.1  # smaller overlaps count as none
_ROWS = 64  # regions processed at a time: about 60 bytes per other region that shares a Gaussian


@dataclass(frozen=True)
class LiftedRegions:
    """The R regions of a view as sets of Gaussians.

    A Gaussian belongs to a region that has more than half of its weight in the view.
    """

    starts: I64  # [R + 1]; region r + 1 has the entries starts[r]..starts[r + 1] of `rows`
    rows: NDArray[np.int32]  # Gaussian ids, ascending within a region
    pixels: F32  # [G], weight in the view

    def __len__(self) -> int:
        return len(self.starts) - 1


def lift_regions(sums: LabelSums, members: csr_array) -> LiftedRegions:
    """Lifts regions, which may overlap, from Gaussian weights per image piece.

    Args:
        sums: of a view, by disjoint piece.
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
    """Partitions regions greedily by priority into groups of ascending rows.

    The free region of highest priority starts a group; free regions whose mean overlap with the group exceeds
    `min_overlap` join.
    """
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
    """Overlaps of P regions of V views on G Gaussians.

    Attributes:
        weights: CSR float32 [P, G]: pixels filled by the region's Gaussians.
        pairs: CSR float64 [P, P]: intersection over union on Gaussians seen by both views, 1 on the diagonal. Omits
            values below 0.1 and pairs where a view sees too little of the other's region.
    """

    weights: csr_array
    pairs: csr_array
    whole: F32  # [P]: total weight of a region's Gaussians
    owner: I64  # [P]: the region's view
    visible: NDArray[np.bool_]  # [V, G]
    size: F32  # [G]: pixels filled, mean over the views

    def agreement(self, min_overlap: float) -> F64:
        """Sums over views the largest overlap above `min_overlap` with a region, [P]."""
        rows = np.repeat(np.arange(len(self.owner)), np.diff(self.pairs.indptr))
        over = self.pairs.data > min_overlap
        best = np.zeros((len(self.owner), len(self.visible)))
        np.maximum.at(best, (rows[over], self.owner[self.pairs.indices[over]]), self.pairs.data[over])
        result = np.zeros(len(self.owner))
        for of_view in best.T:  # sequential, so that equal sums stay equal
            result += of_view
        return result


def overlaps_of(lifted: Iterable[LiftedRegions]) -> Overlaps:
    """Computes the overlaps of all views' regions, in order, consuming one at a time."""
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
    starts = starts.astype(np.int32 if starts[-1] < 1 << 31 else np.int64)  # int64 would also widen the indices
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
        rows, partners = start + np.repeat(np.arange(common.shape[0]), np.diff(common.indptr)), common.indices
        here, there = seen_by[rows, owner[partners]], seen_by[partners, owner[rows]]
        enough = (here / whole[rows] > _ENOUGH) & (there / whole[partners] > _ENOUGH)
        overlap = np.where(enough, common.data / np.maximum(here + there - common.data, 1e-12), 0.0)
        is_pair = (overlap >= _LEAST) & (rows != partners)
        columns.append(partners[is_pair])
        values.append(overlap[is_pair].astype(np.float64))
        sizes += np.bincount(rows[is_pair], minlength=count)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    shape = (count, count)
    pair_matrix = csr_array(
        (np.concatenate([*values, np.zeros(0)]), np.concatenate([*columns, np.zeros(0, np.int32)]), starts), shape=shape
    )
    return (pair_matrix + eye_array(count, format="csr")).tocsr()


def one_piece_each(regions: int, sums: LabelSums) -> csr_array:
    """Builds `members` of `lift_regions` where region r is piece r + 1."""
    pieces = max(regions, int(sums.labels.max()) if len(sums.labels) else 0) + 1
    entries = (np.ones(regions), (np.arange(regions) + 1, np.arange(regions)))
    return csr_array(entries, shape=(pieces, regions))
