"""One owner for each Gaussian: the smallest thing that has it, in one connected piece."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.instances.candidates import F32, Candidate
from fastsplat.service.scene.connectivity import components
from fastsplat.service.scene.types import Gaussians

NOBODY = -1

Owners = NDArray[np.int32]
"""int32 [G]: number of the thing that each Gaussian belongs to, -1 for none."""


def assign_owners(things: Sequence[Candidate], gaussians: int) -> tuple[Owners, F32]:
    """The owner of each of G Gaussians, and float32 [G] the share of views that say so, 0 where there is none.

    Where things overlap the smaller owns, because what lies on or in another shows less of itself.
    """
    owners = np.full(gaussians, NOBODY, np.int32)
    shares = np.zeros(gaussians, np.float32)
    for number in sorted(range(len(things)), key=lambda n: (-things[n].weight, n)):
        owners[things[number].rows] = number
        shares[things[number].rows] = things[number].shares
    return owners, shares


def without_strays(owners: Owners, gaussians: Gaussians, size: F32, min_share: float) -> Owners:
    """The same owners without pieces of a thing that do not touch its largest piece and weigh less than `min_share` of
    it: masks that spill over an edge leave such pieces on what stands behind."""
    result = owners.copy()
    for number in np.unique(owners[owners != NOBODY]).tolist():
        members = np.flatnonzero(owners == number)
        piece = components(gaussians, members)
        weights = np.bincount(piece, size[members].astype(np.float64))
        result[members[(weights < min_share * weights.max())[piece]]] = NOBODY
    return result
