"""Label maps that all views agree on: regions of single views are joined to instances in 3D, named together, and drawn
back into every view.

A detector names an object differently from one view to the next, and misses it in some; the object itself stays where
it is. So regions of all views that cover the same Gaussians are one instance (the masks of a view, lifted by
FlashSplat's blend weights), the names and scores of all its regions are counted together, and instances that few views
agree on are dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import UNDETECTED
from fastsplat.service.perception.types import Regions
from fastsplat.service.scene.types import Evidence, Gaussians
from fastsplat.service.splatting.blending import EvidenceBlend
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.types import Backend
from fastsplat.service.splatting.region_groups import Region, group_regions
from fastsplat.service.splatting.training_views import TrainingView, drop_empty_label_maps, with_labels
from fastsplat.service.splatting.view_evidence import region_sums, views_evidence

_FEWEST_VIEWS = 0.15
_SHARE_OF_VOTES = 0.03


@dataclass(frozen=True)
class Instance:
    """Regions of several views that show the same Gaussians.

    Attributes:
        regions: at most a few a view.
        label: dictionary id.
    """

    regions: tuple[Region, ...]
    label: int


@torch.no_grad()
def fuse_label_maps(
    gaussians: Gaussians,
    views: Sequence[TrainingView],
    regions: Sequence[Regions],
    classes: int,
    *,
    expected: bool,
    undetected_weight: float,
    backend: Backend = "cpu",
) -> tuple[list[NDArray[np.uint16]], Evidence]:
    """The label maps that the views agree on, [H, W] at their training size, and the evidence behind them.

    A pixel of a region gets the label of the region's instance; other pixels what the others' evidence shows there.

    Args:
        gaussians: their geometry must be roughly right; half-way through training it is.
        views: training views.
        regions: of each view, at its image size.
        classes: N + 1.
        expected: every name is expected to be somewhere, see `assign_labels`.
        undetected_weight: what an undetected pixel counts.
        backend: which rasterizer.
    """
    splats = splats_of(gaussians, device=device_of(backend))
    groups = group_regions(
        (region_sums(splats, view, _ids(own, view), backend) for view, own in zip(views, regions, strict=True)),
        [len(own.votes) for own in regions],
    )
    labels_of = [np.zeros(len(own.votes) + 1, np.uint16) for own in regions]
    for instance in assign_labels(groups, regions, classes, expected=expected):
        for view_index, region in instance.regions:
            labels_of[view_index][region] = instance.label
    maps = [table[_ids(own, view)] for table, own, view in zip(labels_of, regions, views, strict=True)]
    labeled = drop_empty_label_maps([with_labels(view, labels) for view, labels in zip(views, maps, strict=True)])
    evidence = views_evidence(gaussians, labeled, classes, undetected_weight=undetected_weight, backend=backend)
    blend = EvidenceBlend(evidence, classes, splats.means.device)
    for index, view in enumerate(views):
        viewmat, camera = view.viewmat.to(splats.means.device), view.frames[-1].camera
        shown = blend.render(splats, viewmat, camera, alpha_min=0.5, relevancy=None, backend=backend).classes
        maps[index] = np.where(maps[index] == UNDETECTED, shown.cpu().numpy().astype(np.uint16), maps[index])
    return maps, evidence


def assign_labels(
    groups: Sequence[tuple[Region, ...]], regions: Sequence[Regions], classes: int, *, expected: bool
) -> list[Instance]:
    """Each group of regions as an instance under the name with most votes; groups seen in too few views are left out.

    A name's votes for a group are the scores of its regions that carry it. Where every name is `expected` to be
    somewhere (the user gave them), votes count as a share of all that the name got: what is called a mug by a detector
    that calls everything a mug is then less a mug than it is the one thing that is ever called a ramekin. Names with
    less than 3 % of a group's votes are out of the question.
    """
    viewed = sum(bool(view.votes) for view in regions)
    fewest = max(min(2, viewed), round(_FEWEST_VIEWS * viewed))
    agreed = [group for group in groups if len({view for view, _ in group}) >= fewest]
    votes = np.zeros((len(agreed), classes))
    for row, group in enumerate(agreed):
        for view, region in group:
            for label, score in regions[view].votes[region - 1]:
                votes[row, label] += score
    votes[votes < _SHARE_OF_VOTES * votes.sum(axis=1, keepdims=True)] = 0
    if expected:
        votes = votes / np.maximum(votes.sum(axis=0), 1e-12)
    return [Instance(group, int(np.argmax(row))) for group, row in zip(agreed, votes, strict=True) if row.any()]


def _ids(regions: Regions, view: TrainingView) -> NDArray[np.uint16]:
    camera = view.frames[-1].camera
    return regions.resized(camera.width, camera.height)
