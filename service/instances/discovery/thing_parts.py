"""Parts of things, from candidates that the hierarchy assigns to a larger thing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fastsplat.service.instances.discovery.candidates import F32, Candidate
from fastsplat.service.instances.discovery.ownership import NOBODY, Owners, membership_of
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.scene.artefact.scene import Parts, Thing

_PIXELS = 64.0  # membership evidence in pixels; large against the prior, so that vote shares become probabilities
_MOST = 0.8  # a candidate with more of its thing's weight is the thing itself


def find_parts(
    candidates: Sequence[tuple[Candidate, int]], owners: Owners, size: F32, settings: DiscoverySettings, first_id: int
) -> Parts | None:
    """Finds the parts of things, the largest first; None if there are none.

    A part has the Gaussians of its candidate that its thing owns; where parts overlap, the smaller one has them. Parts
    lighter than `min_weight_px`, or with most of their thing, are dropped.

    Args:
        candidates: parts with the number of their thing.
        owners: int32 [G], number of the thing of each Gaussian, -1 for none; number n has the id n + 1.
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
    last = first_id + len(parts) - 1  # reversed: the largest, found last, comes first
    table = tuple(replace(part, id=last - number) for number, part in enumerate(parts))[::-1]
    rows = np.flatnonzero(owner != NOBODY)
    return Parts(table, membership_of(rows, last - owner[rows], sure[rows], count, pixels=_PIXELS))
