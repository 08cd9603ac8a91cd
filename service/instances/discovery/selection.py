"""Selection of things among candidates: hierarchy, owners and surfaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fastsplat.service.instances.discovery.candidates import F32, Candidate
from fastsplat.service.instances.discovery.hierarchy import find_hierarchy
from fastsplat.service.instances.discovery.ownership import NOBODY, STRAY_SHARE, Owners, assign_owners, without_strays
from fastsplat.service.instances.discovery.surfaces import Plane, find_surfaces, join_surfaces, lies_off
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.scene.artefact.scene import Gaussians

_GROWN_SHARE = 0.6  # vote share of a Gaussian that joined a surface by its place alone


@dataclass(frozen=True)
class Selection:
    """The things of a scene before they are described."""

    things: tuple[Candidate, ...]  # the largest first
    owners: Owners
    shares: F32  # [G], certainty of the owner as share of views; 0 without owner
    surfaces: Mapping[int, Plane]  # by thing number
    parts: tuple[tuple[Candidate, int], ...] = ()  # with the number of their thing
    groups: tuple[Candidate, ...] = ()


def select_things(
    candidates: Sequence[Candidate], gaussians: Gaussians, size: F32, settings: DiscoverySettings
) -> Selection:
    """Selects things among candidates, with each Gaussian in at most one.

    Parts do not lie off a surface's plane, smaller things own shared Gaussians, surfaces own what lies in their planes,
    and strays are removed. `size` [G] is as in `Overlaps`.
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
    """Removes things that lost their Gaussians to others, and sorts the largest first."""
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
