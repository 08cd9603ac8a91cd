"""Candidates to things: hierarchy, owners, and surfaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fastsplat.service.instances.candidates import F32, Candidate
from fastsplat.service.instances.hierarchy import find_hierarchy
from fastsplat.service.instances.ownership import NOBODY, STRAY_SHARE, Owners, assign_owners, without_strays
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.instances.surfaces import Plane, find_surfaces, join_surfaces, lies_off
from fastsplat.service.scene.types import Gaussians

_GROWN_SHARE = 0.6
"""Share of votes of a Gaussian that joined a surface by its place alone."""


@dataclass(frozen=True)
class Selection:
    """The things of a scene before they are described.

    Attributes:
        things: T candidates.
        owners: int32 [G], number of the thing of each Gaussian, -1 for none.
        shares: float32 [G], how sure that is: share of the views that say so; 0 where nobody owns.
        surfaces: the planes of things that are surfaces.
        parts: candidates that are parts, each with the number of the thing that it is a part of, the largest first.
        groups: candidates that are several things.
    """

    things: tuple[Candidate, ...]
    owners: Owners
    shares: F32
    surfaces: Mapping[int, Plane]
    parts: tuple[tuple[Candidate, int], ...] = ()
    groups: tuple[Candidate, ...] = ()


def select_things(
    candidates: Sequence[Candidate], gaussians: Gaussians, size: F32, settings: DiscoverySettings
) -> Selection:
    """The things among candidates, each Gaussian with one of them at most: things by the hierarchy, without what lies
    off the plane of a surface; the smaller owns; surfaces have what lies in their planes; strays are left out.

    Args:
        candidates: see `find_candidates`.
        gaussians: G of them.
        size: float32 [G], see `Overlaps`.
    """
    planes = find_surfaces(candidates, gaussians, size)

    def apart(part: int, whole: int) -> bool:
        return whole in planes and lies_off(planes[whole], candidates[part].rows, gaussians, size)

    hierarchy = find_hierarchy(candidates, size, settings, apart)
    things = [candidates[row] for row in hierarchy.things]
    places = {row: place for place, row in enumerate(hierarchy.things)}
    parts = [(candidates[part], places[whole]) for part, whole in hierarchy.part_of.items()]
    owners, shares = assign_owners(things, len(gaussians))
    surfaces = {places[row]: plane for row, plane in planes.items() if row in places}
    owners = join_surfaces(owners, things, surfaces, gaussians, size)
    owners = without_strays(owners, gaussians, size, STRAY_SHARE)
    shares = np.where(owners == NOBODY, np.float32(0), np.maximum(shares, np.float32(_GROWN_SHARE)))
    groups = tuple(candidates[row] for row in hierarchy.groups)
    return replace(_numbered(things, parts, owners, shares, surfaces, size, settings), groups=groups)


def _numbered(
    things: Sequence[Candidate],
    parts: Sequence[tuple[Candidate, int]],
    owners: Owners,
    shares: F32,
    surfaces: Mapping[int, Plane],
    size: F32,
    settings: DiscoverySettings,
) -> Selection:
    """Without things that have lost their Gaussians to others, the largest first."""
    owned = owners != NOBODY
    weights = np.bincount(owners[owned], size[owned].astype(np.float64), minlength=len(things))
    order = [n for n in np.argsort(-weights, kind="stable").tolist() if weights[n] >= settings.min_weight_px]
    number = np.full(len(things) + 1, NOBODY, np.int32)  # the last entry is for -1
    number[order] = np.arange(len(order), dtype=np.int32)
    renumbered = number[owners]
    return Selection(
        things=tuple(things[n] for n in order),
        owners=renumbered,
        shares=np.where(renumbered == NOBODY, np.float32(0), shares),
        surfaces={int(number[n]): plane for n, plane in surfaces.items() if number[n] != NOBODY},
        parts=tuple((part, int(number[n])) for part, n in parts if number[n] != NOBODY),
    )
