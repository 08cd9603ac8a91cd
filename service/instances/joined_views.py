"""Views that join a scene with things: which of their masks are known things, and which are new ones.

What is found in the new views alone is a known thing where the two have the same Gaussians; what has mostly Gaussians
that were born for these views is new. Then each thing takes the masks that it matches, as when
things were discovered, and what the views say of the Gaussians that they have changed is added to what was known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.capture.types import View
from fastsplat.service.instances.candidates import find_candidates, view_support
from fastsplat.service.instances.discovery import lifted_masks, masked_view
from fastsplat.service.instances.naming import MOST_SEEN
from fastsplat.service.instances.refinement import refined_membership
from fastsplat.service.instances.selection import Selection, select_things
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.instances.surfaces import surface_kinds
from fastsplat.service.perception.types import ViewMasks
from fastsplat.service.scene.label_evidence import merged, without_rows
from fastsplat.service.scene.new_things import with_new_thing
from fastsplat.service.scene.things import thing_rows
from fastsplat.service.scene.types import F32, Scene, Thing, Things
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.types import Backend
from fastsplat.service.splatting.region_groups import Overlaps, overlaps_of

_NEW = 0.5
"""Share of a new thing's weight that was born."""

Rows = NDArray[np.bool_]


@dataclass(frozen=True)
class JoinedViews:
    """Views that join a scene.

    Attributes:
        views: in the scene's frame; the scene's last cameras are theirs, in this order.
        masks: without names, of each; None where nobody looked.
        changed: bool [G], Gaussians that the views show: only these get other evidence or another code.
        born: bool [G], those of them that were made for the views.
    """

    views: Sequence[View]
    masks: Sequence[ViewMasks | None]
    changed: Rows
    born: Rows


@torch.no_grad()
def with_joined_views(
    scene: Scene, joined: JoinedViews, settings: DiscoverySettings, *, backend: Backend = "cpu"
) -> tuple[Scene, tuple[int, ...]]:
    """The scene with what the masks of more views say of its things, and the ids of things that are new.

    Args:
        scene: with things and the views' cameras.
        joined: the views.
        settings: as when its things were discovered.
        backend: which rasterizer.

    Raises:
        LimitExceededError: as `with_new_thing`.
    """
    first = len(scene.cameras) - len(joined.views)
    numbers = [first + place for place, own in enumerate(joined.masks) if own is not None]
    seen = [masked_view(v, own, settings) for v, own in zip(joined.views, joined.masks, strict=True) if own is not None]
    quality = [own.quality for own in joined.masks if own is not None]
    assert scene.things is not None
    if not sum(map(len, quality)):
        return scene, ()
    before = thing_rows(scene.things)
    splats = splats_of(scene.gaussians, device=device_of(backend))
    overlaps = overlaps_of(lifted_masks(splats, view, backend) for view in seen)
    candidates = find_candidates(
        overlaps, np.concatenate(quality), min_overlap=settings.min_overlap, min_views=settings.min_views
    )
    selection = select_things(candidates, scene.gaussians, overlaps.size, settings)
    scene = replace(scene, things=_seen_again(scene.things, before, overlaps, numbers, settings))
    scene, owner, new = _with_new_things(scene, before, selection, overlaps, numbers, joined, settings)
    shares = np.ones(len(owner), np.float32)
    told = refined_membership(owner - 1, shares, scene.gaussians, seen, overlaps.size, settings, backend)
    assert scene.things is not None
    known = without_rows(scene.things.membership, joined.born)
    membership = merged([known, without_rows(told, ~joined.changed)])
    things = replace(scene.things, membership=membership)
    after = thing_rows(things)
    moved = joined.changed & (after != before)
    if things.parts is not None:  # what it was a part of is another thing's
        things = replace(things, parts=replace(things.parts, membership=without_rows(things.parts.membership, moved)))
    codes = _codes(scene.gaussians.codes, before, after, moved, joined.born)
    return replace(scene, things=things, gaussians=replace(scene.gaussians, codes=codes)), new


def _with_new_things(
    scene: Scene,
    before: NDArray[np.int32],
    selection: Selection,
    overlaps: Overlaps,
    numbers: Sequence[int],
    joined: JoinedViews,
    settings: DiscoverySettings,
) -> tuple[Scene, NDArray[np.int32], tuple[int, ...]]:
    """The scene with the things of the selection that are new, the owner [G] of each Gaussian, and the new ids."""
    owner, size = before.copy(), overlaps.size.astype(np.float64)
    known = _known(selection, before, size, joined.born, settings.min_overlap)
    cameras = np.stack([view.posed.world_from_camera[:3, 3] for view in joined.views])
    new: list[Thing] = []
    for number, candidate in enumerate(selection.things):
        own = selection.owners == number
        if number in known:
            owner[own & joined.born] = known[number]
            continue
        rows = np.flatnonzero(own & joined.born)  # what a person has discarded stays nothing
        if size[rows].sum() < max(_NEW * size[own].sum(), settings.min_weight_px):
            continue
        scene, thing_id = with_new_thing(scene, rows)
        owner[rows] = thing_id
        planes = {number: selection.surfaces[number]} if number in selection.surfaces else {}
        centers = {number: scene.gaussians.means[rows].mean(axis=0).astype(np.float64)}
        new.append(
            Thing(
                thing_id,
                consensus=min(1.0, candidate.consensus),
                surface=surface_kinds(planes, centers, cameras, scene.up()).get(number, ""),
                proposed_in=tuple(numbers[view] for view in candidate.proposed_in),
                missed_in=tuple(numbers[view] for view in candidate.missed_in),
            )
        )
    things = scene.things
    assert things is not None
    made = {thing.id: thing for thing in new}
    things = replace(things, table=tuple(made.get(thing.id, thing) for thing in things.table))
    return replace(scene, things=things), owner, tuple(made)


def _known(
    selection: Selection, before: NDArray[np.int32], size: NDArray[np.float64], born: Rows, min_overlap: float
) -> dict[int, int]:
    """Which things of the selection are which known ones: those that overlap enough; and of the others those that do so
    where both could be, among the Gaussians that were there before, as a floor that the new views show more of."""
    known: dict[int, int] = {}
    for there in (np.ones_like(born), ~born):
        shared = np.zeros((len(selection.things) + 1, int(before.max(initial=0)) + 1))
        np.add.at(shared, (selection.owners[there] + 1, np.where(born, 0, before)[there]), size[there])
        together = shared.sum(1, keepdims=True) + shared.sum(0, keepdims=True) - shared
        overlap = shared / np.maximum(together, 1e-12)
        overlap[0], overlap[:, 0] = 0, 0
        overlap[[number + 1 for number in known]], overlap[:, list(known.values())] = 0, 0
        for number, best in enumerate(overlap.argmax(1)[1:].tolist()):
            if overlap[number + 1, best] >= min_overlap and overlap[:, best].argmax() == number + 1:
                known[number] = best
    return known


def _seen_again(
    things: Things,
    owner: NDArray[np.int32],
    overlaps: Overlaps,
    numbers: Sequence[int],
    settings: DiscoverySettings,
) -> Things:
    """The things, each with the new views that see most of it: those that propose it, and those that do not."""
    whole = np.bincount(owner, minlength=int(owner.max(initial=0)) + 1)
    sees = np.array([np.bincount(owner[seen], minlength=len(whole)) > MOST_SEEN * whole for seen in overlaps.visible])
    fit, _ = view_support(overlaps, [np.flatnonzero(owner == thing.id).astype(np.int32) for thing in things.table])

    def again(thing: Thing, own: NDArray[np.float64]) -> Thing:
        if thing.id >= len(whole) or not (thing.proposed_in or thing.missed_in):
            return thing
        able = np.flatnonzero(sees[:, thing.id])
        proposes = own[able] >= settings.min_overlap
        proposed = (*thing.proposed_in, *(numbers[view] for view in able[proposes]))
        missed = (*thing.missed_in, *(numbers[view] for view in able[~proposes]))
        return replace(
            thing, proposed_in=proposed, missed_in=missed, consensus=len(proposed) / (len(proposed) + len(missed))
        )

    return replace(things, table=tuple(again(thing, own) for thing, own in zip(things.table, fit, strict=True)))


def _codes(codes: F32, before: NDArray[np.int32], after: NDArray[np.int32], moved: Rows, born: Rows) -> F32:
    """Codes in which each Gaussian that has `moved` to another known thing has the mean code of that thing."""
    result = codes.copy()
    for thing_id in np.unique(after[moved]).tolist():
        own = (before == thing_id) & ~born
        if own.any():
            result[moved & (after == thing_id)] = codes[own].mean(axis=0)
    return result
