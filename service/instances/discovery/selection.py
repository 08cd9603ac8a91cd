"""Selection of things among candidates: hierarchy, owners and surfaces."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fastsplat.service.instances.discovery.candidates import F32, Candidate, common_weights
from fastsplat.service.instances.discovery.ownership import NOBODY, STRAY_SHARE, Owners, assign_owners, without_strays
from fastsplat.service.instances.discovery.surfaces import Plane, find_surfaces, join_surfaces, lies_off
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.scene.artefact.scene import Gaussians

_GROWN_SHARE = 0.6  # vote share of a Gaussian that joined a surface by its place alone

_LEAST_SUPPORT = 0.35  # candidates with less support are chance
_LEAST_CONSENSUS = 0.4  # least consensus of a thing; candidates with less may be parts
_INSIDE = 0.8  # share of a candidate's weight inside a larger one that makes it the larger one's child
_SMALLER = 0.8  # children weigh less than this share of their parent
_COVERED = 0.6  # share of a group's weight that its members must cover


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


@dataclass(frozen=True)
class _Hierarchy:
    """Relations of candidates, by number."""

    things: tuple[int, ...]  # the largest first
    part_of: dict[int, int]  # thing of each part
    groups: dict[int, tuple[int, ...]]  # members of each group


def find_hierarchy(
    candidates: Sequence[Candidate],
    size: F32,
    settings: DiscoverySettings,
    apart: Callable[[int, int], bool] = lambda part, whole: False,
) -> _Hierarchy:
    """Finds parts, things and groups among candidates.

    In ascending weight, each candidate with enough consensus is compared with the things in it. If these cover most of
    it, and their support, summed over its Gaussians, exceeds its own, it is a group. Otherwise it is a thing; things in
    it whose edges the masks miss by less than its own remain things, the others become its parts. Candidates with less
    consensus are parts of the smallest thing around them.

    Args:
        candidates: see `find_candidates`.
        size: float32 [G], see `Overlaps`.
        settings: for the least weight of a thing.
        apart: True if the first of two candidates (by number), despite its place, is no part of the second.
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
    error = (1 - support) * np.sqrt(weight)  # of the edge: the same rim costs a small thing more overlap
    agreed = np.array([candidates[number].consensus for number in sure]) >= _LEAST_CONSENSUS
    things: list[int] = []
    whole: dict[int, int] = {}
    groups: dict[int, tuple[int, ...]] = {}
    for one in [n for n in np.argsort(weight, kind="stable").tolist() if agreed[n]]:
        children = [n for n in things if lies_in[n, one]]
        own = np.zeros(len(size))
        for child in reversed(children):  # smaller ones, which came first, overwrite
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
    return _Hierarchy(tuple(sure[thing] for thing in reversed(things)), part_of, groups)
