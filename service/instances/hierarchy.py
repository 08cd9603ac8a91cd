"""Which candidates are things: not the parts of a thing, nor a group of several."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fastsplat.service.instances.candidates import F32, Candidate, common_weights
from fastsplat.service.instances.settings import DiscoverySettings

_LEAST_SUPPORT = 0.35
"""Candidates with less are chance."""
_LEAST_CONSENSUS = 0.4
"""Share of the views that see most of a candidate that must propose it for it to be a thing; else it may be a part."""
_INSIDE = 0.8
"""Share of a candidate's weight inside a larger one from which it is the larger one's child."""
_SMALLER = 0.8
"""Children weigh less than this share of their parent."""
_COVERED = 0.6
"""Share of a group's weight that its members cover."""


@dataclass(frozen=True)
class Hierarchy:
    """What the candidates are to each other.

    Attributes:
        things: numbers of the candidates that are things, the largest first.
        part_of: for each candidate that is a part, the thing it belongs to.
        groups: candidates that are several things, with the members that say so.
    """

    things: tuple[int, ...]
    part_of: dict[int, int]
    groups: dict[int, tuple[int, ...]]


def find_hierarchy(
    candidates: Sequence[Candidate],
    size: F32,
    settings: DiscoverySettings,
    apart: Callable[[int, int], bool] = lambda part, whole: False,
) -> Hierarchy:
    """Parts, things and groups among candidates.

    From the smallest up, each candidate that enough views propose is compared with the things in it. Where these cover
    most of it, and are worth more by their support than all of it by its own, it is a group of them. Otherwise it is a
    thing: those in it whose edges the masks miss by less than its own stay things, the others are its parts. Candidates
    that too few views propose are parts of the smallest thing that they lie in.

    Args:
        candidates: see `find_candidates`.
        size: float32 [G], see `Overlaps`.
        settings: the least weight of a thing.
        apart: whether the first of two candidates' numbers cannot be a part of the second, though it lies in it.
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
    error = (1 - support) * np.sqrt(weight)  # of the edge: a rim of one width costs a small thing more of its overlap
    agreed = np.array([candidates[number].consensus for number in sure]) >= _LEAST_CONSENSUS
    things: list[int] = []
    whole: dict[int, int] = {}
    groups: dict[int, tuple[int, ...]] = {}
    for one in [n for n in np.argsort(weight, kind="stable").tolist() if agreed[n]]:
        children = [n for n in things if lies_in[n, one]]
        own = np.zeros(len(size))
        for child in reversed(children):  # the smaller, which came first, owns
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
