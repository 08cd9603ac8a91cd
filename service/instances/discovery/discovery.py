"""Discovery of objects without a vocabulary, from the views' masks and a splat."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.capture.captures import View
from fastsplat.service.instances.discovery.candidates import F32, Candidate, common_weights, find_candidates
from fastsplat.service.instances.discovery.lifting import lift_masks
from fastsplat.service.instances.discovery.ownership import (
    NOBODY,
    STRAY_SHARE,
    Owners,
    assign_owners,
    membership_of,
    without_strays,
)
from fastsplat.service.instances.discovery.refinement import MaskedView, refined_membership
from fastsplat.service.instances.discovery.surfaces import Plane, find_surfaces, join_surfaces, lies_off, surface_kinds
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.perception.results import ViewMasks
from fastsplat.service.scene.artefact.scene import Evidence, Gaussians, Object, ObjectGroup, Objects, Parts
from fastsplat.service.scene.objects.label_evidence import evidence_of, no_evidence, posterior
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.labels.region_groups import LiftedRegions, overlaps_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend, Splats
from fastsplat.service.splatting.training_views import training_size

_MOST = 0.7  # share of an object's weight in a candidate that makes it a member

_PIXELS = 64.0  # membership evidence in pixels; large against the prior, so that vote shares become probabilities
_MOST_OF_PART = 0.8  # a candidate with more of its object's weight is the object itself

_GROWN_SHARE = 0.6  # vote share of a Gaussian that joined a surface by its place alone

_LEAST_SUPPORT = 0.35  # candidates with less support are chance
_LEAST_CONSENSUS = 0.4  # least consensus of an object; candidates with less may be parts
_INSIDE = 0.8  # share of a candidate's weight inside a larger one that makes it the larger one's child
_SMALLER = 0.8  # children weigh less than this share of their parent
_COVERED = 0.6  # share of a group's weight that its members must cover


def find_groups(candidates: Sequence[Candidate], owners: Owners, size: F32, first_id: int) -> tuple[ObjectGroup, ...]:
    """Finds groups of at least two objects, by descending consensus and without duplicates.

    Object number n of `owners` [G] has the id n + 1, -1 is none; `size` [G] is as in `Overlaps`.
    """
    weights = size.astype(np.float64)
    whole = np.bincount(owners + 1, weights)[1:]
    groups: dict[tuple[int, ...], float] = {}
    for candidate in sorted(candidates, key=lambda candidate: -candidate.consensus):
        inside = np.bincount(owners[candidate.rows] + 1, weights[candidate.rows], minlength=len(whole) + 1)[1:]
        members = tuple((np.flatnonzero((whole > 0) & (inside >= _MOST * whole)) + 1).tolist())
        if len(members) >= 2:
            groups.setdefault(members, min(1.0, candidate.consensus))
    return tuple(ObjectGroup(number, *group) for number, group in enumerate(groups.items(), start=first_id))


F64 = NDArray[np.float64]

OnView = Callable[[int, int], None]
"""Called with the number of views done and their total; may raise `CancelledError`."""


@dataclass(frozen=True)
class Discovery:
    """Discovered objects, with counts."""

    objects: Objects  # without names; ids from 1, the largest first; membership in pixels
    views: int
    prompts: int  # to the segmenter
    proposals: int  # masks that were lifted


@torch.no_grad()
def discover_objects(
    gaussians: Gaussians,
    views: Sequence[View],
    masks: Sequence[ViewMasks | None],
    up: F64 | None,
    settings: DiscoverySettings,
    on_view: OnView = lambda done, total: None,
    *,
    backend: Backend = "cpu",
) -> Discovery:
    """Finds the objects that the masks of several views agree on.

    Args:
        gaussians: G of them, trained.
        masks: of each view, see `propose_capture_masks`; views with None do not count.
        up: unit vector, float64 [3], see `Scene.up`; None if unknown.
    """
    used = [(view, view_masks) for view, view_masks in zip(views, masks, strict=True) if view_masks is not None]
    numbers = [number for number, view_masks in enumerate(masks) if view_masks is not None]
    splats = splats_of(gaussians, device=device_of(backend))
    masked: list[MaskedView] = []
    lifted: list[LiftedRegions] = []
    for view, view_masks in used:
        masked.append(masked_view(view, view_masks, settings))
        lifted.append(lifted_masks(splats, masked[-1], backend))
        on_view(len(lifted), len(used))
    objects = Objects((), no_evidence(len(gaussians)))
    if used:
        overlaps, quality = overlaps_of(lifted), np.concatenate([view_masks.quality for _, view_masks in used])
        candidates = find_candidates(overlaps, quality, min_overlap=settings.min_overlap, min_views=settings.min_views)
        selection = select_objects(candidates, gaussians, overlaps.size, settings)
        membership = refined_membership(
            selection.owners, selection.shares, gaussians, masked, overlaps.size, settings, backend
        )
        objects = _described(selection, membership, gaussians, overlaps.size, views, numbers, up, settings)
    return Discovery(
        objects=objects,
        views=len(used),
        prompts=sum(view_masks.prompts for _, view_masks in used),
        proposals=sum(len(regions) for regions in lifted),
    )


def masked_view(view: View, masks: ViewMasks, settings: DiscoverySettings) -> MaskedView:
    """Scales a view and its masks to the size for lifting."""
    camera = training_size(view.posed.camera, settings.max_side)
    return MaskedView(replace(view.posed, camera=camera), masks, view.valid_path)


def lifted_masks(splats: Splats, view: MaskedView, backend: Backend) -> LiftedRegions:
    """Lifts the masks of a view to Gaussians, see `lift_masks`."""
    viewmat = torch.from_numpy(view.posed.camera_from_world().astype(np.float32))
    return lift_masks(splats, viewmat, view.posed.camera, view.masks(), valid=view.valid(), backend=backend)


def _described(
    selection: _Selection,
    membership: Evidence,
    gaussians: Gaussians,
    size: NDArray[np.float32],
    views: Sequence[View],
    numbers: Sequence[int],
    up: F64 | None,
    settings: DiscoverySettings,
) -> Objects:
    """Builds objects with enough Gaussians, the largest first; `numbers` are those of the used views."""
    count = len(selection.objects)
    owners = posterior(membership, count + 1).classes
    weights = np.bincount(owners, size.astype(np.float64), minlength=count + 1)[1:]
    order = [n for n in np.argsort(-weights, kind="stable").tolist() if weights[n] >= settings.min_weight_px]
    surfaces = {n: plane for n, plane in selection.surfaces.items() if n in order}
    centers = {n: gaussians.means[owners == n + 1].mean(axis=0).astype(np.float64) for n in surfaces}
    cameras = np.stack([view.posed.world_from_camera[:3, 3] for view in views])
    kinds = surface_kinds(surfaces, centers, cameras, up)
    table = tuple(
        Object(
            id=place,
            consensus=min(1.0, selection.objects[n].consensus),
            surface=kinds.get(n, ""),
            proposed_in=tuple(numbers[view] for view in selection.objects[n].proposed_in),
            missed_in=tuple(numbers[view] for view in selection.objects[n].missed_in),
        )
        for place, n in enumerate(order, start=1)
    )
    ids = np.zeros(count + 1, np.int64)
    ids[np.array(order, np.intp) + 1] = np.arange(1, len(order) + 1)
    rows = np.repeat(np.arange(len(membership)), np.diff(membership.starts))
    inside = [(part, int(ids[n + 1]) - 1) for part, n in selection.parts if ids[n + 1]]
    numbers_of_objects = (ids[owners] - 1).astype(np.int32)
    parts = find_parts(inside, numbers_of_objects, size, settings, len(table) + 1)
    first = len(table) + 1 + (0 if parts is None else len(parts.table))
    groups = find_groups(selection.groups, numbers_of_objects, size, first)
    members = evidence_of(rows, ids[membership.labels], membership.counts, len(membership))
    return Objects(table, members, first + len(groups), parts, groups=groups)


def find_parts(
    candidates: Sequence[tuple[Candidate, int]], owners: Owners, size: F32, settings: DiscoverySettings, first_id: int
) -> Parts | None:
    """Finds the parts of objects, the largest first; None if there are none.

    A part has the Gaussians of its candidate that its object owns; where parts overlap, the smaller one has them. Parts
    lighter than `min_weight_px`, or with most of their object, are dropped.

    Args:
        candidates: parts with the number of their object.
        owners: int32 [G], number of the object of each Gaussian, -1 for none; number n has the id n + 1.
        size: float32 [G], see `Overlaps`.
    """
    count = len(owners)
    whole = np.bincount(owners + 1, size.astype(np.float64))[1:]
    claims = []
    for part, obj in candidates:
        inside = owners[part.rows] == obj
        rows, shares = part.rows[inside], part.shares[inside]
        weight = float(size[rows].sum())
        if inside.any() and weight <= _MOST_OF_PART * whole[obj]:
            claims.append((weight, rows, shares, Object(first_id, consensus=min(1.0, part.consensus), parent=obj + 1)))
    owner, sure = np.full(count, NOBODY, np.int32), np.zeros(count, np.float32)
    parts: list[Object] = []
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


@dataclass(frozen=True)
class _Selection:
    """The objects of a scene before they are described."""

    objects: tuple[Candidate, ...]  # the largest first
    owners: Owners
    shares: F32  # [G], certainty of the owner as share of views; 0 without owner
    surfaces: Mapping[int, Plane]  # by object number
    parts: tuple[tuple[Candidate, int], ...] = ()  # with the number of their object
    groups: tuple[Candidate, ...] = ()


def select_objects(
    candidates: Sequence[Candidate], gaussians: Gaussians, size: F32, settings: DiscoverySettings
) -> _Selection:
    """Selects objects among candidates, with each Gaussian in at most one.

    Parts do not lie off a surface's plane, smaller objects own shared Gaussians, surfaces own what lies in their
    planes, and strays are removed. `size` [G] is as in `Overlaps`.
    """
    planes = find_surfaces(candidates, gaussians, size)

    def apart(part: int, whole: int) -> bool:
        return whole in planes and lies_off(planes[whole], candidates[part].rows, gaussians, size)

    hierarchy = find_hierarchy(candidates, size, settings, apart)
    objects = [candidates[row] for row in hierarchy.objects]
    places = {row: place for place, row in enumerate(hierarchy.objects)}
    parts = [(candidates[part], places[whole]) for part, whole in hierarchy.part_of.items()]
    owners, shares = assign_owners(objects, len(gaussians))
    surfaces = {places[row]: plane for row, plane in planes.items() if row in places}
    owners = join_surfaces(owners, objects, surfaces, gaussians, size)
    owners = without_strays(owners, gaussians, size, STRAY_SHARE)
    shares = np.where(owners == NOBODY, np.float32(0), np.maximum(shares, np.float32(_GROWN_SHARE)))
    groups = tuple(candidates[row] for row in hierarchy.groups)
    # Objects that lost their Gaussians to others are removed, and the largest come first.
    has_owner = owners != NOBODY
    weights = np.bincount(owners[has_owner], size[has_owner].astype(np.float64), minlength=len(objects))
    order = [n for n in np.argsort(-weights, kind="stable").tolist() if weights[n] >= settings.min_weight_px]
    number = np.full(len(objects) + 1, NOBODY, np.int32)  # the last entry is for -1
    number[order] = np.arange(len(order), dtype=np.int32)
    renumbered = number[owners]
    return _Selection(
        objects=tuple(objects[n] for n in order),
        owners=renumbered,
        shares=np.where(renumbered == NOBODY, np.float32(0), shares),
        surfaces={int(number[n]): plane for n, plane in surfaces.items() if number[n] != NOBODY},
        parts=tuple((part, int(number[n])) for part, n in parts if number[n] != NOBODY),
        groups=groups,
    )


@dataclass(frozen=True)
class _Hierarchy:
    """Relations of candidates, by number."""

    objects: tuple[int, ...]  # the largest first
    part_of: dict[int, int]  # object of each part
    groups: dict[int, tuple[int, ...]]  # members of each group


def find_hierarchy(
    candidates: Sequence[Candidate],
    size: F32,
    settings: DiscoverySettings,
    apart: Callable[[int, int], bool] = lambda part, whole: False,
) -> _Hierarchy:
    """Finds parts, objects and groups among candidates.

    In ascending weight, each candidate with enough consensus is compared with the objects in it. If these cover most of
    it, and their support, summed over its Gaussians, exceeds its own, it is a group. Otherwise it is an object; objects
    in it whose edges the masks miss by less than its own remain objects, the others become its parts. Candidates with
    less consensus are parts of the smallest object around them.

    Args:
        candidates: see `find_candidates`.
        size: float32 [G], see `Overlaps`.
        settings: for the least weight of an object.
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
    error = (1 - support) * np.sqrt(weight)  # of the edge: the same rim costs a small object more overlap
    agreed = np.array([candidates[number].consensus for number in sure]) >= _LEAST_CONSENSUS
    objects: list[int] = []
    whole: dict[int, int] = {}
    groups: dict[int, tuple[int, ...]] = {}
    for index in [n for n in np.argsort(weight, kind="stable").tolist() if agreed[n]]:
        children = [n for n in objects if lies_in[n, index]]
        child_support = np.zeros(len(size))
        for child in reversed(children):  # smaller ones, which came first, overwrite
            child_support[candidates[sure[child]].rows] = support[child]
        rows = candidates[sure[index]].rows
        covered = size[rows][child_support[rows] > 0].sum() / weight[index]
        if covered >= _COVERED and (child_support[rows] - support[index]) @ size[rows] > 0:
            if len(children) > 1:
                groups[sure[index]] = tuple(sure[child] for child in reversed(children))
            continue
        lesser = [child for child in children if error[child] >= error[index]]
        rare = [piece for piece in np.flatnonzero(~agreed & lies_in[:, index]).tolist() if piece not in whole]
        for part in [*lesser, *rare]:
            if not apart(sure[part], sure[index]):
                whole[part] = index
        objects = [*(obj for obj in objects if obj not in whole), index]
    part_of = {}
    for part in whole:
        obj = part
        while obj in whole:
            obj = whole[obj]
        part_of[sure[part]] = sure[obj]
    return _Hierarchy(tuple(sure[obj] for obj in reversed(objects)), part_of, groups)
