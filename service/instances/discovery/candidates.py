"""Candidate objects: groups of mask proposals that show the same Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fastsplat.service.splatting.labels.region_groups import I64, Overlaps, greedy_groups

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

_OVERLAPS = (0.35, 0.5, 0.65, 0.8)  # mean overlaps of proposals at which they are grouped
_MOST_SEEN = 0.5  # share of a candidate that a view must see to count for its support
_MEMBER = 0.5  # share of views above which a Gaussian belongs to a candidate


@dataclass(frozen=True)
class Candidate:
    """A group of mask proposals of the same Gaussians."""

    rows: NDArray[np.int32]  # [K], ascending Gaussian ids, in the masks of most proposing views that see them
    shares: F32  # [K], that share of views, 0.5..1
    weight: float  # pixels that its Gaussians fill in a view, mean over all views
    support: float  # mean best overlap with a mask, over the views that see most of it, 0..1
    proposed_in: tuple[int, ...] = ()  # numbers of the views that see most of it and have its mask, ascending
    missed_in: tuple[int, ...] = ()  # numbers of the other views that see most of it

    @property
    def consensus(self) -> float:
        """Share of the views that see most of it that propose it, 0..1."""
        return len(self.proposed_in) / max(1, len(self.proposed_in) + len(self.missed_in))


def find_candidates(overlaps: Overlaps, quality: F32, *, min_overlap: float, min_views: int) -> list[Candidate]:
    """Finds candidates proposed by enough views, without duplicates, by descending support.

    Proposals are grouped at several overlaps.

    Args:
        overlaps: of P proposals.
        quality: float32 [P].
        min_overlap: intersection over union from which two are the same.
        min_views: to propose a candidate; at most the number of views.
    """
    fewest = min(min_views, len(overlaps.visible))
    groups: dict[tuple[int, ...], I64] = {}
    for level in _OVERLAPS:
        for group in greedy_groups(overlaps, overlaps.agreement(level) * quality, level):
            if len(np.unique(overlaps.owner[group])) >= fewest:
                groups[tuple(group.tolist())] = group
    visible_from = np.ascontiguousarray(overlaps.visible.T)
    members = [_members(overlaps, visible_from, group) for group in groups.values()]
    members = [member for member in members if overlaps.size[member[0]].sum() > 0]
    support, sees = view_support(overlaps, [member[0] for member in members])
    candidates = []
    for number, (rows, shares) in enumerate(members):
        able = np.flatnonzero(sees[number])
        proposes = support[number, able] >= min_overlap
        candidates.append(
            Candidate(
                rows=rows,
                shares=shares,
                weight=float(overlaps.size[rows].sum(dtype=np.float64)),
                support=float(support[number, able].mean()) if len(able) else 0.0,
                proposed_in=tuple(able[proposes].tolist()),
                missed_in=tuple(able[~proposes].tolist()),
            )
        )
    candidates.sort(key=lambda candidate: (-candidate.support, -candidate.weight, candidate.rows.tolist()))
    return [candidates[row] for row in _without_doubles(candidates, overlaps.size, min_overlap)]


def view_support(overlaps: Overlaps, sets: Sequence[NDArray[np.int32]]) -> tuple[F64, NDArray[np.bool_]]:
    """Measures the fit of C sets of Gaussians to the masks of V views.

    Args:
        overlaps: of the proposals.
        sets: each int32 [K], ascending ids.

    Returns:
        float64 [C, V], best intersection over union of a mask with what the view sees of the set, 0..1; and bool
        [C, V], True where the view sees most of the set.
    """
    inside, weighted = _incidence(sets, overlaps.size)
    whole = np.asarray(weighted.sum(axis=1))
    seen = np.asarray(weighted @ overlaps.visible.T.astype(np.float64)).reshape(len(sets), len(overlaps.visible))
    common = (overlaps.weights @ inside.T).tocoo()
    masks, columns = common.coords
    views = overlaps.owner[masks]
    fit = common.data / np.maximum(seen[columns, views] + overlaps.whole[masks] - common.data, 1e-12)
    best = np.zeros(seen.shape)
    np.maximum.at(best, (columns, views), fit)
    return best, seen >= _MOST_SEEN * whole[:, None]


def common_weights(candidates: Sequence[Candidate], size: F32) -> F64:
    """Weights shared by pairs of C candidates, float64 [C, C]; `size` [G] as in `Overlaps`."""
    inside, weighted = _incidence([candidate.rows for candidate in candidates], size)
    return np.asarray((weighted @ inside.T).toarray())


def _incidence(sets: Sequence[NDArray[np.int32]], size: F32) -> tuple[csr_array, csr_array]:
    """CSR float64 [C, G] of sets of Gaussians: ones, and the Gaussians' sizes."""
    columns = np.concatenate([*sets, np.zeros(0, np.int32)])
    starts = np.concatenate([[0], np.cumsum([len(rows) for rows in sets])]).astype(np.int64)
    shape = (len(sets), len(size))
    incidence = csr_array((np.ones(len(columns)), columns, starts), shape=shape)
    return incidence, csr_array((size[columns].astype(np.float64), columns, starts), shape=shape)


def _members(overlaps: Overlaps, visible_from: NDArray[np.bool_], group: I64) -> tuple[NDArray[np.int32], F32]:
    views = np.unique(overlaps.owner[group])
    gaussians: list[NDArray[np.int32]] = []
    for view in views:  # one vote a view, even with several of its proposals in the group
        weights = overlaps.weights[group[overlaps.owner[group] == view]]
        gaussians.append(np.unique(weights.indices))
    rows, votes = np.unique(np.concatenate(gaussians), return_counts=True)
    shares = votes / np.maximum(visible_from[rows][:, views].sum(axis=1), 1)
    members = shares > _MEMBER
    return rows[members].astype(np.int32), shares[members].astype(np.float32)


def _without_doubles(candidates: Sequence[Candidate], size: F32, min_overlap: float) -> list[int]:
    common = common_weights(candidates, size)
    weights = np.diag(common)
    overlap = common / np.maximum(weights[:, None] + weights - common, 1e-12)
    first: list[int] = []
    for row in range(len(candidates)):
        if not (overlap[row, first] >= min_overlap).any():
            first.append(row)
    return first
