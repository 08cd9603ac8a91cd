"""Groups of things, from candidates that the hierarchy takes for several things."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fastsplat.service.instances.candidates import F32, Candidate
from fastsplat.service.instances.ownership import Owners
from fastsplat.service.scene.types import ThingGroup

_MOST = 0.7  # share of a thing's weight in a candidate that makes it a member


def find_groups(candidates: Sequence[Candidate], owners: Owners, size: F32, first_id: int) -> tuple[ThingGroup, ...]:
    """Finds groups of at least two things, by descending consensus and without duplicates.

    Thing number n of `owners` [G] has the id n + 1, -1 is none; `size` [G] is as in `Overlaps`.
    """
    weights = size.astype(np.float64)
    whole = np.bincount(owners + 1, weights)[1:]
    groups: dict[tuple[int, ...], float] = {}
    for candidate in sorted(candidates, key=lambda one: -one.consensus):
        inside = np.bincount(owners[candidate.rows] + 1, weights[candidate.rows], minlength=len(whole) + 1)[1:]
        members = tuple((np.flatnonzero((whole > 0) & (inside >= _MOST * whole)) + 1).tolist())
        if len(members) >= 2:
            groups.setdefault(members, min(1.0, candidate.consensus))
    return tuple(ThingGroup(number, *group) for number, group in enumerate(groups.items(), start=first_id))
