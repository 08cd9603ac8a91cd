"""Parts of things: candidates that the hierarchy counts to a larger thing, with the Gaussians that they have of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.instances.candidates import F32
from fastsplat.service.instances.ownership import NOBODY
from fastsplat.service.instances.selection import Selection
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.scene.label_evidence import UNIT, evidence_of
from fastsplat.service.scene.types import Evidence, Parts, Thing

_PIXELS = 64.0
"""Evidence of a Gaussian's membership, in pixels: much against the prior, so that shares of votes are probabilities."""
_MOST = 0.8
"""A candidate with more of its thing's weight is the thing itself, and no part."""


def membership_of(rows: NDArray[np.integer], labels: NDArray[np.integer], shares: F32, gaussians: int) -> Evidence:
    """Membership of `gaussians` Gaussians: for each of `rows` [K] its share of votes, 0..1, for its label [K], and the
    rest for none."""
    inside = np.rint(shares * _PIXELS * UNIT).astype(np.int64)
    outside = round(_PIXELS * UNIT) - inside
    return evidence_of(
        np.concatenate([rows, rows]),
        np.concatenate([labels, np.zeros(len(rows), np.int64)]),
        np.concatenate([inside, outside]),
        gaussians,
    )


def find_parts(selection: Selection, size: F32, settings: DiscoverySettings, first_id: int) -> Parts | None:
    """The parts of the things of a selection, the largest first; None for none.

    A part has those Gaussians of its candidate that its thing owns. Where parts overlap the smaller has them, as among
    things. What fills fewer pixels than a thing must (`min_weight_px`), or most of its thing, is no part.

    Args:
        selection: its thing number n has the id n + 1.
        size: float32 [G], see `Overlaps`.
        settings: the bounds.
        first_id: id of the first part.
    """
    count = len(selection.owners)
    whole = np.bincount(selection.owners + 1, size.astype(np.float64), minlength=len(selection.things) + 1)[1:]
    owner, shares = np.full(count, NOBODY, np.int32), np.zeros(count, np.float32)
    parts = []
    for part, thing in selection.parts:
        own = selection.owners[part.rows] == thing
        weight = float(size[part.rows[own]].sum())
        if settings.min_weight_px <= weight <= _MOST * whole[thing]:
            parts.append((weight, thing, part.consensus, part.rows[own], part.shares[own]))
    parts.sort(key=lambda one: -one[0])
    for number, (_, _, _, rows, inside) in enumerate(parts):
        owner[rows], shares[rows] = number, inside
    has = np.bincount(owner[owner != NOBODY], minlength=len(parts)) > 0
    ids = np.cumsum(has) + first_id - 1
    table = tuple(
        Thing(int(ids[number]), consensus=min(1.0, consensus), parent=thing + 1)
        for number, (_, thing, consensus, _, _) in enumerate(parts)
        if has[number]
    )
    rows = np.flatnonzero(owner != NOBODY)
    return Parts(table, membership_of(rows, ids[owner[rows]], shares[rows], count)) if table else None
