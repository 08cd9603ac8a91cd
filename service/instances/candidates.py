"""Candidates for things: groups of mask proposals that several views agree on, each a soft set of Gaussians.

Every view votes: of the views that see a candidate, those count for it in which the segmenter proposed it. The share of
them, the consensus rate, is high for what stands by itself and low for parts and for accidents of one view (the view
consensus of MaskClustering, Yan et al. 2024, here by the overlap of Gaussians).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fastsplat.service.splatting.region_groups import Overlaps, greedy_groups

F32 = NDArray[np.float32]

_MOST_SEEN = 0.5
"""Share of a candidate's Gaussians that a view must see to have a vote."""
_ENOUGH_VIEWS = 3
"""Fewer views that see a Gaussian say less about it."""
_MEMBER = 0.5
"""Share of votes from which a Gaussian belongs to a candidate."""


@dataclass(frozen=True)
class Candidate:
    """A group of proposals that show the same Gaussians.

    Attributes:
        rows: int32 [K], its Gaussians, ascending: those that more than half of the views that propose it and see them
            have inside.
        shares: float32 [K], that share, 0.5..1.
        weak_rows: int32 [L], ascending: its Gaussians, and those that fewer of the views have inside.
        weak_shares: float32 [L], the share of views, 0..1, less where fewer than three views see the Gaussian.
        weight: pixels that its Gaussians fill in a view, mean over all views.
        consensus: share of the views that see most of it that propose it, 0..1.
        views: number of views that propose it.
        proposed_in: numbers of these views, ascending.
        missed_in: numbers of the other views that see most of it.
        quality: mean quality of the proposals, 0..1.
        proposals: their numbers.
    """

    rows: NDArray[np.int32]
    shares: F32
    weak_rows: NDArray[np.int32]
    weak_shares: F32
    weight: float
    consensus: float
    views: int
    quality: float
    proposals: tuple[int, ...]
    proposed_in: tuple[int, ...] = ()
    missed_in: tuple[int, ...] = ()


def find_candidates(
    overlaps: Overlaps, quality: F32, *, min_overlap: float, min_views: int, min_view_share: float
) -> list[Candidate]:
    """All candidates that enough views propose, doubles left out, by descending consensus times quality.

    Args:
        overlaps: of P proposals.
        quality: float32 [P].
        min_overlap: of proposals that are the same thing; candidates that overlap more are one.
        min_views: that must propose a candidate; never more than there are.
        min_view_share: as `min_views`, as a share of all views.
    """
    views = len(overlaps.visible)
    fewest = max(min(min_views, views), round(min_view_share * views))
    groups = greedy_groups(overlaps, overlaps.agreement(min_overlap) * quality, min_overlap)
    visible_from = np.ascontiguousarray(overlaps.visible.T)
    large = [group for group in groups if len(np.unique(overlaps.owner[group])) >= fewest]
    described = [_candidate(overlaps, visible_from, group, quality) for group in large]
    solid = sorted(
        (candidate for candidate in described if candidate.weight > 0), key=lambda c: -c.consensus * c.quality
    )
    return [solid[row] for row in _without_doubles(solid, overlaps.size, min_overlap)]


def common_weights(candidates: Sequence[Candidate], size: F32) -> NDArray[np.float64]:
    """float64 [C, C]: the weight of the Gaussians that two candidates share; on the diagonal their own weights.

    Args:
        candidates: C of them.
        size: float32 [G], see `Overlaps`.
    """
    counts = [len(candidate.rows) for candidate in candidates]
    columns = np.concatenate([candidate.rows for candidate in candidates]) if candidates else np.zeros(0, np.int32)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    shape = (len(candidates), len(size))
    ones = csr_array((np.ones(len(columns)), columns, starts), shape=shape)
    weighted = csr_array((size[columns].astype(np.float64), columns, starts), shape=shape)
    return np.asarray((weighted @ ones.T).toarray())


def _candidate(
    overlaps: Overlaps, visible_from: NDArray[np.bool_], group: NDArray[np.int64], quality: F32
) -> Candidate:
    views = np.unique(overlaps.owner[group])
    gaussians: list[NDArray[np.int32]] = []
    for view in views:  # one vote a view, whatever number of its proposals is in the group
        members = overlaps.weights[group[overlaps.owner[group] == view]]
        gaussians.append(np.unique(members.indices))
    rows, votes = np.unique(np.concatenate(gaussians), return_counts=True)
    able = visible_from[rows][:, views].sum(axis=1)
    shares = votes / np.maximum(able, 1)
    members = shares > _MEMBER
    weak_rows, weak_shares = rows, shares * np.minimum(1.0, able / _ENOUGH_VIEWS)
    rows, shares = rows[members], shares[members].astype(np.float32)
    weights = overlaps.size[rows].astype(np.float64)
    weight = float(weights.sum())
    seen = weights @ visible_from[rows] / max(weight, 1e-12)
    voters = np.flatnonzero(seen > _MOST_SEEN)
    return Candidate(
        rows=rows.astype(np.int32),
        shares=shares,
        weak_rows=weak_rows.astype(np.int32),
        weak_shares=weak_shares.astype(np.float32),
        weight=weight,
        consensus=len(np.intersect1d(views, voters)) / max(1, len(voters)),
        views=len(views),
        quality=float(quality[group].mean()),
        proposals=tuple(group.tolist()),
        proposed_in=tuple(views.tolist()),
        missed_in=tuple(np.setdiff1d(voters, views).tolist()),
    )


def _without_doubles(candidates: Sequence[Candidate], size: F32, min_overlap: float) -> list[int]:
    common = common_weights(candidates, size)
    own = np.diag(common)
    overlap = common / np.maximum(own[:, None] + own - common, 1e-12)
    first: list[int] = []
    for row in range(len(candidates)):
        if all(overlap[row, other] < min_overlap for other in first):
            first.append(row)
    return first
