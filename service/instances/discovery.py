"""Everything in the room is a thing: the views and a splat in, things without names out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image as PillowImage

from fastsplat.service.capture.image_io import load_rgb
from fastsplat.service.capture.types import View
from fastsplat.service.instances.candidates import find_candidates
from fastsplat.service.instances.lifting import lift_masks
from fastsplat.service.instances.prompting import dense_views, guided_points
from fastsplat.service.instances.selection import Selection, select_things
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.instances.surfaces import surface_kinds
from fastsplat.service.perception.mask_proposals import (
    distinct_proposals,
    grid_points,
    joined_proposals,
    sure_proposals,
)
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.types import Segmenter, point_prompts
from fastsplat.service.scene.boxes import vertical_axis
from fastsplat.service.scene.label_evidence import UNIT, evidence_of
from fastsplat.service.scene.types import F32, Evidence, Gaussians, Thing, Things
from fastsplat.service.splatting.blending import EvidenceBlend
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster import Backend, Splats, device_of
from fastsplat.service.splatting.region_groups import LiftedRegions, overlaps_of
from fastsplat.service.splatting.training_views import training_size

_PIXELS = 64.0
"""Evidence of a Gaussian's membership, in pixels: much against the prior, so that shares of votes are probabilities."""
_ALPHA_MIN = 0.5
_PROMPTS = 32

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
    segmenter: Segmenter,
    settings: DiscoverySettings,
    perception: PerceptionSettings,
    on_view: OnView = lambda done, total: None,
    *,
    backend: Backend = "cpu",
) -> Discovery:
    """All things that the segmenter's masks of several views agree on, without a vocabulary.

    A few views are prompted on a dense grid. What they say is projected into the others, which are prompted once on
    each thing and where no thing explains the pixels. Then the masks of all views are grouped, and things selected.

    Args:
        gaussians: G of them, trained.
        views: of the capture; at most `max_views` of them, evenly spread, are looked at.
        segmenter: answers prompts.
        settings: how many prompts, and what counts as a thing.
        perception: which masks count.
        on_view: see `OnView`.
        backend: which rasterizer.

    Returns:
        Things whose membership says for each Gaussian the share of views that count it to its thing; a Gaussian is of
        one thing at most.
    """
    some = [views[position] for position in dense_views(len(views), settings.max_views or len(views))]
    looker = _Looker(splats_of(gaussians, device=device_of(backend)), segmenter, settings, perception, backend)
    lifted: dict[int, LiftedRegions] = {}
    quality: dict[int, F32] = {}
    prompts = 0

    def look(position: int, points: NDArray[np.float64]) -> None:
        nonlocal prompts
        lifted[position], quality[position] = looker.look(some[position], points)
        prompts += len(points)
        on_view(len(lifted), len(some))

    for position in dense_views(len(some), settings.dense_views):
        camera = some[position].posed.camera
        look(position, grid_points(camera.width, camera.height, settings.grid))
    guides = _selected(gaussians, lifted, quality, settings.model_copy(update={"min_views": 1, "min_view_share": 0.0}))
    blend = EvidenceBlend(_membership(guides), len(guides.things) + 1, looker.splats.means.device)
    for position in range(len(some)):
        if position not in lifted:
            look(position, looker.points_of(some[position], blend))
    selection = _selected(gaussians, lifted, quality, settings)
    return Discovery(
        things=_things(selection, gaussians, views),
        views=len(some),
        prompts=prompts,
        proposals=sum(len(regions) for regions in lifted.values()),
    )


@dataclass(frozen=True)
class _Looker:
    """Looks at single views."""

    splats: Splats
    segmenter: Segmenter
    settings: DiscoverySettings
    perception: PerceptionSettings
    backend: Backend

    def look(self, view: View, points: NDArray[np.float64]) -> tuple[LiftedRegions, F32]:
        """The masks of what is at points [K, 2] of the view's image, lifted, and their quality."""
        image = load_rgb(view.image_path)
        size = (image.shape[0], image.shape[1])
        embedding = self.segmenter.embed(image)
        parts = []
        for start in range(0, max(len(points), 1), _PROMPTS):  # an answer takes a megabyte, and few of them count
            answer = self.segmenter.mask_logits(embedding, point_prompts(points[start : start + _PROMPTS]))
            parts.append(sure_proposals(answer, size, self.perception))
        proposals = distinct_proposals(joined_proposals(parts), self.perception.proposal_overlap)
        camera = training_size(view.posed.camera, self.settings.max_side)
        masks = proposals.masks(camera.width, camera.height)
        valid = _valid_pixels(view, camera.width, camera.height)
        viewmat = torch.from_numpy(view.posed.camera_from_world().astype(np.float32))
        return lift_masks(self.splats, viewmat, camera, masks, valid=valid, backend=self.backend), proposals.quality

    def points_of(self, view: View, blend: EvidenceBlend) -> NDArray[np.float64]:
        """Where to prompt a view, in pixels of its image, given the things so far."""
        camera = training_size(view.posed.camera, self.settings.max_side)
        viewmat = torch.from_numpy(view.posed.camera_from_world().astype(np.float32)).to(self.splats.means.device)
        shown = blend.render(
            self.splats, viewmat, camera, alpha_min=_ALPHA_MIN, relevancy=None, backend=self.backend
        ).classes.cpu()
        points = guided_points(
            shown.numpy(), self.settings.grid, self.settings.max_unexplained, self.perception.min_pixels
        )
        return points * [view.posed.camera.width / camera.width, view.posed.camera.height / camera.height]


def _selected(
    gaussians: Gaussians, lifted: dict[int, LiftedRegions], quality: dict[int, F32], settings: DiscoverySettings
) -> Selection:
    order = sorted(lifted)
    if not order:
        return select_things([], gaussians, np.zeros(len(gaussians), np.float32), settings)
    overlaps = overlaps_of(lifted[position] for position in order)
    candidates = find_candidates(
        overlaps,
        np.concatenate([quality[position] for position in order]),
        min_overlap=settings.min_overlap,
        min_views=settings.min_views,
        min_view_share=settings.min_view_share,
    )
    return select_things(candidates, gaussians, overlaps.size, settings)


def _membership(selection: Selection) -> Evidence:
    """Its thing's share of votes for each Gaussian, and the rest for no thing."""
    rows = np.arange(len(selection.owners))
    inside = np.rint(selection.shares * _PIXELS * UNIT).astype(np.int64)
    outside = round(_PIXELS * UNIT) - inside
    return evidence_of(
        np.concatenate([rows, rows]),
        np.concatenate([selection.owners + 1, np.zeros(len(rows), np.int64)]),
        np.concatenate([inside, outside]),
        len(rows),
    )


def _things(selection: Selection, gaussians: Gaussians, views: Sequence[View]) -> Things:
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
    return Things(table, _membership(selection))


def _valid_pixels(view: View, width: int, height: int) -> NDArray[np.bool_] | None:
    if view.valid_path is None:
        return None
    with PillowImage.open(view.valid_path) as picture:
        mask = np.asarray(picture.convert("L"))
    return np.asarray(cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA) == 255)
