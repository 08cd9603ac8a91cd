"""Views vote: what single views found is joined to things in 3D, named together, and drawn back into every view.

A detector names a thing differently from one view to the next, and misses it in some; the thing itself stays where it
is. So regions of all views that cover the same Gaussians are one thing (the masks of a view, lifted by FlashSplat's
blend weights), the names and scores of all its regions are counted together, and things few views agree on are dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import UNDETECTED
from fastsplat.service.perception.types import Regions
from fastsplat.service.scene.types import Evidence, Gaussians
from fastsplat.service.splatting.blending import EvidenceBlend
from fastsplat.service.splatting.evidence import activated, region_sums, views_evidence
from fastsplat.service.splatting.raster import Backend, LabelSums
from fastsplat.service.splatting.views import TrainingView, speaking, with_labels

_SEEN_PX = 0.05
_INSIDE = 0.5
_ENOUGH = 0.3
"""Share of a region's Gaussians that another view must see before it can agree or disagree."""
_FEWEST_VIEWS = 0.15
_SHARE_OF_VOTES = 0.03

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Thing:
    """Regions of several views that show the same Gaussians.

    Attributes:
        members: (view, region) pairs, at most a few a view.
        label: dictionary id.
    """

    members: tuple[tuple[int, int], ...]
    label: int


@torch.no_grad()
def voted_maps(
    gaussians: Gaussians,
    views: Sequence[TrainingView],
    regions: Sequence[Regions],
    classes: int,
    *,
    expected: bool,
    undetected_weight: float,
    backend: Backend = "cpu",
) -> tuple[list[NDArray[np.integer]], Evidence]:
    """The label maps that the views agree on, [H, W] at their training size, and the evidence behind them.

    A pixel of a region gets the name of the region's thing; other pixels what the others' evidence shows there.

    Args:
        gaussians: their geometry must be roughly right; half-way through training it is.
        views: training views.
        regions: of each view, at its image size.
        classes: N + 1.
        expected: every name is expected to be somewhere, see `name_things`.
        undetected_weight: what an undetected pixel counts.
        backend: which rasterizer.
    """
    sizes = [frame.camera for frame in (view.frames[-1] for view in views)]
    maps = [found.resized(camera.width, camera.height) for found, camera in zip(regions, sizes, strict=True)]
    splats = activated(gaussians, backend)
    things = things_of(
        [region_sums(splats, view, ids, backend) for view, ids in zip(views, maps, strict=True)],
        [len(found.votes) for found in regions],
    )
    named = name_things(things, regions, classes, expected=expected)
    lookup = [np.zeros(len(found.votes) + 1, np.int32) for found in regions]
    for thing in named:
        for row, region in thing.members:
            lookup[row][region] = thing.label
    relabelled = [table[ids] for table, ids in zip(lookup, maps, strict=True)]
    spoken = speaking(tuple(with_labels(view, labels) for view, labels in zip(views, relabelled, strict=True)))
    evidence = views_evidence(gaussians, spoken, classes, undetected_weight=undetected_weight, backend=backend)
    blend = EvidenceBlend(evidence, classes, splats.means.device)
    filled: list[NDArray[np.integer]] = []
    for view, labels in zip(views, relabelled, strict=True):
        shown = (
            blend.render(
                splats,
                view.viewmat.to(splats.means.device),
                view.frames[-1].camera,
                alpha_min=0.5,
                relevancy=None,
                backend=backend,
            )
            .classes.cpu()
            .numpy()
        )
        filled.append(np.where(labels == UNDETECTED, shown, labels))
    return filled, evidence


def things_of(
    sums: Sequence[LabelSums], counts: Sequence[int], *, overlap: float = 0.5
) -> list[tuple[tuple[int, int], ...]]:
    """Groups of (view, region) that cover the same Gaussians, those with most agreement first.

    Two regions overlap by the intersection over union of the Gaussians more than half of whose weight in the view lies
    in the region, among those that both views see; Gaussians count by the pixels that they fill. The region that most
    views agree with starts a thing; regions whose mean overlap with the thing's exceeds `overlap` join it.

    Args:
        sums: of each view, the weight of each Gaussian by region, 0 = outside all.
        counts: regions of each view.
        overlap: 0..1.
    """
    pairs = [(view, region) for view, count in enumerate(counts) for region in range(1, count + 1)]
    if not pairs:
        return []
    owner = np.array([view for view, _ in pairs])
    similarity = _similarity(sums, pairs)
    np.fill_diagonal(similarity, 1.0)
    agreement = np.zeros(len(pairs))
    for view in np.unique(owner):
        best = similarity[:, owner == view].max(axis=1)
        agreement += np.where(best > overlap, best, 0.0)
    free, groups = np.ones(len(pairs), np.bool_), []
    while free.any():
        first = int(np.argmax(np.where(free, agreement, -1.0)))
        members = np.flatnonzero(free & (similarity[first] > overlap))
        joined = np.flatnonzero(free & (similarity[members].mean(axis=0) > overlap))
        members = joined if first in joined else members
        free[members] = False
        groups.append(tuple(pairs[row] for row in members))
    return groups


def name_things(
    things: Sequence[tuple[tuple[int, int], ...]], regions: Sequence[Regions], classes: int, *, expected: bool
) -> list[Thing]:
    """Each thing under the name with most votes; things seen in too few views are left out.

    A name's votes for a thing are the scores of its regions that carry it. Where every name is `expected` to be
    somewhere (the user gave them), votes count as a share of all that the name got: what is called a mug by a detector
    that calls everything a mug is then less a mug than it is the one thing that is ever called a ramekin. Names with
    less than 3 % of a thing's votes are out of the question.
    """
    looked_at = sum(bool(view.votes) for view in regions)
    fewest = max(min(2, looked_at), round(_FEWEST_VIEWS * looked_at))
    kept = [members for members in things if len({view for view, _ in members}) >= fewest]
    votes = np.zeros((len(kept), classes))
    for row, members in enumerate(kept):
        for view, region in members:
            for label, score in regions[view].votes[region - 1]:
                votes[row, label] += score
    votes[votes < _SHARE_OF_VOTES * votes.sum(axis=1, keepdims=True)] = 0
    if expected:
        votes = votes / np.maximum(votes.sum(axis=0), 1e-12)
    return [Thing(members, int(np.argmax(row))) for members, row in zip(kept, votes, strict=True) if row.any()]


def _similarity(sums: Sequence[LabelSums], pairs: Sequence[tuple[int, int]]) -> F64:
    """[P, P]; 0 where one view sees too little of the other's region to tell."""
    count = len(sums[0].starts) - 1
    seen = np.zeros((len(sums), count), np.float32)
    inside = np.zeros((len(pairs), count), np.float32)
    place = {pair: row for row, pair in enumerate(pairs)}
    for view, found in enumerate(sums):
        rows = np.repeat(np.arange(count), np.diff(found.starts.numpy()))
        labels, weights = found.labels.numpy(), found.sums.numpy()
        seen[view] = np.bincount(rows, weights, count)
        most = weights > _INSIDE * seen[view, rows]
        for region in np.unique(labels[most]):
            if (view, region) in place:
                inside[place[view, int(region)], rows[most & (labels == region)]] = 1
    size = seen.mean(axis=0)
    visible = (seen > _SEEN_PX).astype(np.float32)
    owner = np.array([view for view, _ in pairs])
    inside *= visible[owner]
    weighted = inside * size
    common = weighted @ inside.T
    seen_by_other = (weighted @ visible.T)[:, owner]
    union = seen_by_other + seen_by_other.T - common
    whole = np.maximum(weighted.sum(axis=1, keepdims=True), 1e-12)
    enough = (seen_by_other / whole > _ENOUGH) & ((seen_by_other / whole).T > _ENOUGH)
    return np.where(enough, common / np.maximum(union, 1e-12), 0.0).astype(np.float64)
