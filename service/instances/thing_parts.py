"""Parts of things: candidates that the hierarchy counts to a larger thing, with the Gaussians that they have of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fastsplat.service.instances.candidates import F32, Candidate
from fastsplat.service.instances.ownership import NOBODY, Owners, membership_of
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.scene.types import Parts, Thing

_PIXELS = 64.0
"""Evidence of a Gaussian's membership, in pixels: much against the prior, so that shares of votes are probabilities."""
_MOST = 0.8
"""A candidate with more of its thing's weight is the thing itself, and no part."""


def find_parts(
    candidates: Sequence[tuple[Candidate, int]], owners: Owners, size: F32, settings: DiscoverySettings, first_id: int
) -> Parts | None:
    """The parts of things, the largest first; None for none.

    A part has those Gaussians of its candidate that its thing owns. Where parts overlap the smaller has them, as among
    things. What then fills fewer pixels than a thing must (`min_weight_px`), or fills most of its thing, is no part.

    Args:
        candidates: those that are parts, each with the number of the thing that it is a part of.
        owners: int32 [G], number of the thing of each Gaussian, -1 for none; thing number n has the id n + 1.
        size: float32 [G], see `Overlaps`.
    """
    count = len(owners)
    whole = np.bincount(owners + 1, size.astype(np.float64))[1:]
    claims = []
    for part, thing in candidates:
        own = owners[part.rows] == thing
        rows, shares = part.rows[own], part.shares[own]
        weight = float(size[rows].sum())
        if own.any() and weight <= _MOST * whole[thing]:
            claims.append((weight, rows, shares, Thing(first_id, consensus=min(1.0, part.consensus), parent=thing + 1)))
    owner, sure = np.full(count, NOBODY, np.int32), np.zeros(count, np.float32)
    parts: list[Thing] = []
    for _, rows, shares, claimant in sorted(claims, key=lambda claim: claim[0]):
        free = owner[rows] == NOBODY
        if size[rows[free]].sum() >= settings.min_weight_px:
            owner[rows[free]], sure[rows[free]] = len(parts), shares[free]
            parts.append(claimant)
    if not parts:
        return None
    last = first_id + len(parts) - 1  # the largest, which comes last, is the first
    table = tuple(replace(part, id=last - number) for number, part in enumerate(parts))[::-1]
    rows = np.flatnonzero(owner != NOBODY)
    return Parts(table, membership_of(rows, last - owner[rows], sure[rows], count, pixels=_PIXELS))
