"""Everything in the room is a thing: the views' masks and a splat in, things without names out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image as PillowImage

from fastsplat.service.capture.types import View
from fastsplat.service.instances.candidates import F32, find_candidates
from fastsplat.service.instances.lifting import lift_masks
from fastsplat.service.instances.selection import Selection, select_things
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.instances.surfaces import surface_kinds
from fastsplat.service.instances.thing_parts import find_parts, membership_of
from fastsplat.service.perception.types import ViewMasks
from fastsplat.service.scene.boxes import vertical_axis
from fastsplat.service.scene.types import Gaussians, Thing, Things
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster import Backend, device_of
from fastsplat.service.splatting.region_groups import LiftedRegions, overlaps_of
from fastsplat.service.splatting.training_views import training_size

OnView = Callable[[int, int], None]
"""Called with the number of views done and their total; may raise `CancelledError`."""


@dataclass(frozen=True)
class Discovery:
    """Things, and what it took to discover them.

    Attributes:
        things: T things without names; ids from 1, the largest first.
        views: number of views that were looked at.
        prompts: number of prompts to the segmenter.
        proposals: number of masks that were lifted.
    """

    things: Things
    views: int
    prompts: int
    proposals: int


@torch.no_grad()
def discover_things(
    gaussians: Gaussians,
    views: Sequence[View],
    masks: Sequence[ViewMasks | None],
    settings: DiscoverySettings,
    on_view: OnView = lambda done, total: None,
    *,
    backend: Backend = "cpu",
) -> Discovery:
    """All things that the masks of several views agree on, without a vocabulary.

    Args:
        gaussians: G of them, trained.
        views: of the capture.
        masks: of each view, see `propose_capture_masks`; views with None have no say.
        settings: what counts as a thing.
        on_view: see `OnView`.
        backend: which rasterizer.

    Returns:
        Things whose membership says for each Gaussian the share of views that count it to its thing; a Gaussian is of
        one thing at most.
    """
    used = [(view, own) for view, own in zip(views, masks, strict=True) if own is not None]
    splats = splats_of(gaussians, device=device_of(backend))
    lifted: list[LiftedRegions] = []
    for view, own in used:
        camera = training_size(view.posed.camera, settings.max_side)
        viewmat = torch.from_numpy(view.posed.camera_from_world().astype(np.float32))
        valid = _valid_pixels(view, camera.width, camera.height)
        flat = own.resized(camera.width, camera.height)
        lifted.append(lift_masks(splats, viewmat, camera, flat, valid=valid, backend=backend))
        on_view(len(lifted), len(used))
    return Discovery(
        things=_things(*_selected(gaussians, lifted, [own for _, own in used], settings), gaussians, views, settings),
        views=len(used),
        prompts=sum(own.prompts for _, own in used),
        proposals=sum(len(regions) for regions in lifted),
    )


def _selected(
    gaussians: Gaussians, lifted: Sequence[LiftedRegions], masks: Sequence[ViewMasks], settings: DiscoverySettings
) -> tuple[Selection, F32]:
    if not lifted:
        size = np.zeros(len(gaussians), np.float32)
        return select_things([], gaussians, size, settings), size
    overlaps = overlaps_of(lifted)
    candidates = find_candidates(
        overlaps,
        np.concatenate([own.quality for own in masks]),
        min_overlap=settings.min_overlap,
        min_views=settings.min_views,
        min_view_share=settings.min_view_share,
    )
    return select_things(candidates, gaussians, overlaps.size, settings), overlaps.size


def _things(
    selection: Selection, size: F32, gaussians: Gaussians, views: Sequence[View], settings: DiscoverySettings
) -> Things:
    centers = {
        number: gaussians.means[selection.owners == number].mean(axis=0).astype(np.float64)
        for number in selection.surfaces
    }
    cameras = np.stack([view.posed.world_from_camera[:3, 3] for view in views]) if views else np.zeros((0, 3))
    kinds = surface_kinds(dict(selection.surfaces), centers, cameras, vertical_axis([view.posed for view in views]))
    table = tuple(
        Thing(id=number + 1, consensus=min(1.0, thing.consensus), surface=kinds.get(number, ""))
        for number, thing in enumerate(selection.things)
    )
    rows = np.arange(len(selection.owners))
    membership = membership_of(rows, selection.owners + 1, selection.shares, len(rows))
    parts = find_parts(selection, size, settings, len(table) + 1)
    return Things(table, membership, len(table) + 1 + (0 if parts is None else len(parts.table)), parts)


def _valid_pixels(view: View, width: int, height: int) -> NDArray[np.bool_] | None:
    if view.valid_path is None:
        return None
    with PillowImage.open(view.valid_path) as picture:
        mask = np.asarray(picture.convert("L"))
    return np.asarray(cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA) == 255)
