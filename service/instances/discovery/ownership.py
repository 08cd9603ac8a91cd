"""Assignment of Gaussians to at most one object, the smallest one, in connected pieces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fastsplat.service.instances.discovery.candidates import F32, Candidate
from fastsplat.service.scene.artefact.scene import Evidence, Gaussians
from fastsplat.service.scene.gaussians.connectivity import components
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of

STRAY_SHARE = 0.1
"""Disconnected pieces lighter than this share of an object's largest piece are removed."""
FILLING_NEIGHBORS = 8
"""Number of nearest Gaussians that vote for the owner of one without."""

NOBODY = -1

_ROUNDS = 6
_ENOUGH = 0.4  # share of a Gaussian's neighbors that must belong to an object for it to join
_REACH = 2.0  # neighbors beyond this multiple of their own distance to their last neighbor are ignored

Owners = NDArray[np.int32]
"""int32 [G]: number of the object of each Gaussian, -1 for none."""


def assign_owners(objects: Sequence[Candidate], gaussians: int) -> tuple[Owners, F32]:
    """Assigns G Gaussians to the smallest object; also returns float32 [G], its share of views."""
    owners = np.full(gaussians, NOBODY, np.int32)
    shares = np.zeros(gaussians, np.float32)
    for number in sorted(range(len(objects)), key=lambda n: (-objects[n].weight, n)):
        owners[objects[number].rows] = number
        shares[objects[number].rows] = objects[number].shares
    return owners, shares


def without_strays(owners: Owners, gaussians: Gaussians, size: F32, min_share: float) -> Owners:
    """Removes light pieces (masks that spill over an edge) that touch no main piece."""
    result = owners.copy()
    for number in np.unique(owners[owners != NOBODY]).tolist():
        members = np.flatnonzero(owners == number)
        piece = components(gaussians, members)
        weights = np.bincount(piece, size[members].astype(np.float64))
        result[members[(weights < min_share * weights.max())[piece]]] = NOBODY
    return result


def with_neighbors(owners: Owners, gaussians: Gaussians, size: F32, neighbors: int) -> Owners:
    """Assigns visible Gaussians without owner to the object of enough neighbors, in rounds."""
    visible = np.flatnonzero(size > 0)
    count = min(neighbors, len(visible) - 1)
    result = owners.copy()
    if count < 1 or not (owners[visible] == NOBODY).any():
        return result
    distances, places = cKDTree(gaussians.means[visible]).query(gaussians.means[visible], count + 1)
    open_places = np.flatnonzero(owners[visible] == NOBODY)
    near, free = places[open_places, 1:], visible[open_places]
    reach = _REACH * distances[:, -1]
    far = distances[open_places, 1:] > reach[near]
    for _ in range(_ROUNDS):
        around = np.where(far, NOBODY, result[visible[near]])
        same = (around[:, :, None] == around[:, None, :]).sum(axis=2)
        same[around == NOBODY] = 0
        most = same.argmax(axis=1)
        rows = np.arange(len(free))
        joins = (result[free] == NOBODY) & (same[rows, most] >= _ENOUGH * count)
        result[free[joins]] = around[rows, most][joins]
    return result


def membership_of(
    rows: NDArray[np.integer], labels: NDArray[np.integer], shares: F32, gaussians: int, *, pixels: float
) -> Evidence:
    """Builds membership of `gaussians` Gaussians from vote shares.

    Each of `rows` [K] has `pixels` of evidence: its share [K], 0..1, for its label [K], the rest for none.
    """
    inside = np.rint(shares * pixels * UNIT).astype(np.int64)
    outside = round(pixels * UNIT) - inside
    return evidence_of(
        np.concatenate([rows, rows]),
        np.concatenate([labels, np.zeros(len(rows), np.int64)]),
        np.concatenate([inside, outside]),
        gaussians,
    )
