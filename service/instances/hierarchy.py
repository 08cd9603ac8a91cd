"""Which candidates are things: not the parts of a thing, nor a group of several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.instances.candidates import F32, Candidate, common_weights
from fastsplat.service.instances.settings import DiscoverySettings

_MIN_CONSENSUS = 0.45
"""Share of the views that see a thing that must propose it."""
_NESTED_SCORE = 0.77
"""What lies inside a larger thing is a thing of its own from this consensus times quality, and its part below."""

F64 = NDArray[np.float64]

_INSIDE = 0.8
"""Share of a candidate's weight inside another from which it is one of the other's children."""
_SMALLER = 0.8
"""Children weigh less than this share of their parent."""
_APART = 0.5
"""Children that share less are different ones."""
_COVERED = 0.7
"""Share of a group's weight that its members cover."""
_LARGE = 0.15
"""Share of a thing's weight from which what lies inside it is large."""
_PART = 0.6
"""Share of a candidate's weight inside a larger thing from which it is a part of the thing, or lies in it."""


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


def find_hierarchy(candidates: Sequence[Candidate], size: F32, settings: DiscoverySettings) -> Hierarchy:
    """Parts, things and groups among candidates.

    Candidates below `min_consensus` are left out. A candidate is a group when two or more of its children, which do not
    overlap each other, have at least its own consensus and cover most of it. Of the others the larger come first. One
    that mostly lies inside a thing is its part, unless it is a thing of its own that lies in the other: because so many
    views are so sure of it (`nested_score`, of consensus times quality), or because it is large and they are surer of
    it than of the whole, as of a bed that some views take for one thing with the doll on it.

    Args:
        candidates: see `find_candidates`.
        size: float32 [G], see `Overlaps`.
        settings: the bounds.
    """
    sure = [row for row, candidate in enumerate(candidates) if candidate.consensus >= _MIN_CONSENSUS]
    consensus = np.array([candidates[row].consensus for row in sure])
    score = consensus * np.array([candidates[row].quality for row in sure])
    common = common_weights([candidates[row] for row in sure], size)
    weight = np.diag(common)
    inside = common / np.maximum(weight[:, None], 1e-12)
    groups: dict[int, tuple[int, ...]] = {}
    for place, row in enumerate(sure):
        children = np.flatnonzero((inside[:, place] > _INSIDE) & (weight < _SMALLER * weight[place]))
        members = _apart(children[consensus[children] >= consensus[place]], inside, weight)
        if len(members) >= 2 and common[members, place].sum() > _COVERED * weight[place]:
            groups[row] = tuple(sure[member] for member in members)
    things: list[int] = []
    part_of: dict[int, int] = {}
    for place in np.argsort(-weight, kind="stable").tolist():
        if sure[place] in groups or weight[place] < settings.min_weight_px:
            continue
        whole = next((thing for thing in reversed(things) if inside[place, thing] > _PART), None)
        large = whole is not None and weight[place] > _LARGE * weight[whole]
        if whole is None or score[place] >= _NESTED_SCORE or (large and score[place] > score[whole]):
            things.append(place)
        else:
            part_of[sure[place]] = sure[whole]
    return Hierarchy(tuple(sure[thing] for thing in things), part_of, groups)


def _apart(children: NDArray[np.intp], inside: F64, weight: F64) -> list[int]:
    """Children that do not overlap, the largest first."""
    members: list[int] = []
    for child in children[np.argsort(-weight[children], kind="stable")].tolist():
        if all(inside[child, member] < _APART for member in members):
            members.append(child)
    return members
