"""Classification of candidates as things, parts of things, or groups of things."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fastsplat.service.instances.discovery.candidates import F32, Candidate, common_weights
from fastsplat.service.instances.discovery_settings import DiscoverySettings

_LEAST_SUPPORT = 0.35  # candidates with less support are chance
_LEAST_CONSENSUS = 0.4  # least consensus of a thing; candidates with less may be parts
_INSIDE = 0.8  # share of a candidate's weight inside a larger one that makes it the larger one's child
_SMALLER = 0.8  # children weigh less than this share of their parent
_COVERED = 0.6  # share of a group's weight that its members must cover


@dataclass(frozen=True)
class Hierarchy:
    """Relations of candidates, by number."""

    things: tuple[int, ...]  # the largest first
    part_of: dict[int, int]  # thing of each part
    groups: dict[int, tuple[int, ...]]  # members of each group


def find_hierarchy(
    candidates: Sequence[Candidate],
    size: F32,
    settings: DiscoverySettings,
    apart: Callable[[int, int], bool] = lambda part, whole: False,
) -> Hierarchy:
    """Finds parts, things and groups among candidates.

    In ascending weight, each candidate with enough consensus is compared with the things in it. If these cover most of
    it, and their support, summed over its Gaussians, exceeds its own, it is a group. Otherwise it is a thing; things in
    it whose edges the masks miss by less than its own remain things, the others become its parts. Candidates with less
    consensus are parts of the smallest thing around them.

    Args:
        candidates: see `find_candidates`.
        size: float32 [G], see `Overlaps`.
        settings: for the least weight of a thing.
        apart: True if the first of two candidates (by number), despite its place, is no part of the second.
    """
    sure = [
        number
        for number, candidate in enumerate(candidates)
        if candidate.support >= _LEAST_SUPPORT and candidate.weight >= settings.min_weight_px
    ]
    common = common_weights([candidates[number] for number in sure], size)
    weight = np.diag(common)
    lies_in = (common > _INSIDE * weight[:, None]) & (weight[:, None] < _SMALLER * weight)
    support = np.array([candidates[number].support for number in sure])
    error = (1 - support) * np.sqrt(weight)  # of the edge: the same rim costs a small thing more overlap
    agreed = np.array([candidates[number].consensus for number in sure]) >= _LEAST_CONSENSUS
    things: list[int] = []
    whole: dict[int, int] = {}
    groups: dict[int, tuple[int, ...]] = {}
    for one in [n for n in np.argsort(weight, kind="stable").tolist() if agreed[n]]:
        children = [n for n in things if lies_in[n, one]]
        own = np.zeros(len(size))
        for child in reversed(children):  # smaller ones, which came first, overwrite
            own[candidates[sure[child]].rows] = support[child]
        rows = candidates[sure[one]].rows
        covered = size[rows][own[rows] > 0].sum() / weight[one]
        if covered >= _COVERED and (own[rows] - support[one]) @ size[rows] > 0:
            if len(children) > 1:
                groups[sure[one]] = tuple(sure[child] for child in reversed(children))
            continue
        lesser = [child for child in children if error[child] >= error[one]]
        rare = [piece for piece in np.flatnonzero(~agreed & lies_in[:, one]).tolist() if piece not in whole]
        for part in [*lesser, *rare]:
            if not apart(sure[part], sure[one]):
                whole[part] = one
        things = [*(thing for thing in things if thing not in whole), one]
    part_of = {}
    for part in whole:
        thing = part
        while thing in whole:
            thing = whole[thing]
        part_of[sure[part]] = sure[thing]
    return Hierarchy(tuple(sure[thing] for thing in reversed(things)), part_of, groups)
