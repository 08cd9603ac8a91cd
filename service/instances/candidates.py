"""Candidates for things: groups of mask proposals that show the same, each a soft set of Gaussians, and how well the
views' own masks support it.

Proposals are grouped at several overlaps. Every view that sees most of a candidate says how well the best of its masks
fits; the mean is the candidate's support.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fastsplat.service.splatting.region_groups import I64, Overlaps, greedy_groups

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

_OVERLAPS = (0.35, 0.5, 0.65, 0.8)
"""Mean overlaps of proposals at which they are grouped."""
_MOST_SEEN = 0.5
"""Share of a candidate's Gaussians that a view must see to have a say."""
_MEMBER = 0.5
"""Share of views from which a Gaussian belongs to a candidate."""


@dataclass(frozen=True)
class Candidate:
    """A group of proposals that show the same Gaussians.

    Attributes:
        rows: int32 [K], its Gaussians, ascending: those that more than half of the views that propose it and see them
            have inside.
        shares: float32 [K], that share, 0.5..1.
        weight: pixels that its Gaussians fill in a view, mean over all views.
        support: mean, over the views that see most of it, of the best overlap with one of the view's masks, 0..1.
        proposed_in: numbers of the views that see most of it and have a mask that is the same, ascending.
        missed_in: numbers of the other views that see most of it.
    """

    rows: NDArray[np.int32]
    shares: F32
    weight: float
    support: float
    proposed_in: tuple[int, ...] = ()
    missed_in: tuple[int, ...] = ()

    @property
    def consensus(self) -> float:
        """Share of the views that see most of it that propose it, 0..1."""
        return len(self.proposed_in) / max(1, len(self.proposed_in) + len(self.missed_in))


def find_candidates(overlaps: Overlaps, quality: F32, *, min_overlap: float, min_views: int) -> list[Candidate]:
    """All candidates that enough views propose, by descending support; of those that are the same, the best supported.

    Args:
        overlaps: of P proposals.
        quality: float32 [P].
        min_overlap: what overlaps at least so much is the same.
        min_views: that must propose a candidate; never more than there are.
    """
    fewest = min(min_views, len(overlaps.visible))
    groups: dict[tuple[int, ...], I64] = {}
    for level in _OVERLAPS:
        for group in greedy_groups(overlaps, overlaps.agreement(level) * quality, level):
            if len(np.unique(overlaps.owner[group])) >= fewest:
                groups[tuple(group.tolist())] = group
    visible_from = np.ascontiguousarray(overlaps.visible.T)
    members = [_members(overlaps, visible_from, group) for group in groups.values()]
    members = [own for own in members if overlaps.size[own[0]].sum() > 0]
    support, sees = view_support(overlaps, [own[0] for own in members])
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
    candidates.sort(key=lambda one: (-one.support, -one.weight, one.rows.tolist()))
    return [candidates[row] for row in _without_doubles(candidates, overlaps.size, min_overlap)]


def view_support(overlaps: Overlaps, sets: Sequence[NDArray[np.int32]]) -> tuple[F64, NDArray[np.bool_]]:
    """How well the masks of each view fit sets of Gaussians.

    Args:
        overlaps: of the proposals of V views.
        sets: C of them, each int32 [K], ascending ids.

    Returns:
        float64 [C, V]: the best intersection over union of what the view sees of the set with one of its masks, 0..1;
        and bool [C, V]: whether the view sees most of the set.
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
    """float64 [C, C]: the weight of the Gaussians that two candidates share; on the diagonal their own weights.

    Args:
        candidates: C of them.
        size: float32 [G], see `Overlaps`.
    """
    inside, weighted = _incidence([candidate.rows for candidate in candidates], size)
    return np.asarray((weighted @ inside.T).toarray())


def _incidence(sets: Sequence[NDArray[np.int32]], size: F32) -> tuple[csr_array, csr_array]:
    """CSR float64 [C, G] of sets of Gaussians: 1 inside, and the Gaussian's size inside."""
    columns = np.concatenate([*sets, np.zeros(0, np.int32)])
    starts = np.concatenate([[0], np.cumsum([len(rows) for rows in sets])]).astype(np.int64)
    shape = (len(sets), len(size))
    ones = csr_array((np.ones(len(columns)), columns, starts), shape=shape)
    return ones, csr_array((size[columns].astype(np.float64), columns, starts), shape=shape)


def _members(overlaps: Overlaps, visible_from: NDArray[np.bool_], group: I64) -> tuple[NDArray[np.int32], F32]:
    views = np.unique(overlaps.owner[group])
    gaussians: list[NDArray[np.int32]] = []
    for view in views:  # one vote a view, whatever number of its proposals is in the group
        own = overlaps.weights[group[overlaps.owner[group] == view]]
        gaussians.append(np.unique(own.indices))
    rows, votes = np.unique(np.concatenate(gaussians), return_counts=True)
    shares = votes / np.maximum(visible_from[rows][:, views].sum(axis=1), 1)
    members = shares > _MEMBER
    return rows[members].astype(np.int32), shares[members].astype(np.float32)


def _without_doubles(candidates: Sequence[Candidate], size: F32, min_overlap: float) -> list[int]:
    common = common_weights(candidates, size)
    own = np.diag(common)
    overlap = common / np.maximum(own[:, None] + own - common, 1e-12)
    first: list[int] = []
    for row in range(len(candidates)):
        if not (overlap[row, first] >= min_overlap).any():
            first.append(row)
    return first
