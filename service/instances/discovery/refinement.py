"""Pixel-wise membership: rendered objects take matching masks, Gaussians count their pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image as PillowImage

from fastsplat.service.instances.discovery.ownership import (
    FILLING_NEIGHBORS,
    NOBODY,
    STRAY_SHARE,
    Owners,
    membership_of,
    with_neighbors,
    without_strays,
)
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.perception.results import ViewMasks
from fastsplat.service.scene.artefact.scene import F32, Evidence, Gaussians
from fastsplat.service.scene.objects.label_evidence import evidence_of, merged, posterior
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.labels.blending import EvidenceBlend
from fastsplat.service.splatting.labels.view_evidence import view_evidence
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat_contract.geometry.camera import PosedCamera

_SEEN_PX = 16  # objects with fewer pixels in a view take no mask there
UNKNOWN = -1
"""Label of ignored pixels."""


_PENDING_ENTRIES = 1 << 21  # number of entries, about 50 bytes each, at which evidence of several views is merged


@dataclass(frozen=True)
class MaskedView:
    """A view at the size for lifting; masks stay packed until they are read."""

    posed: PosedCamera
    proposals: ViewMasks  # without names
    valid_path: Path | None = None  # image of the pixels with content; None: all

    def masks(self) -> NDArray[np.bool_]:
        """bool [P, H, W]."""
        return self.proposals.resized(self.posed.camera.width, self.posed.camera.height)

    def valid(self) -> NDArray[np.bool_] | None:
        """bool [H, W], pixels that have content; None: all."""
        if self.valid_path is None:
            return None
        with PillowImage.open(self.valid_path) as picture:
            mask = np.asarray(picture.convert("L"))
        size = (self.posed.camera.width, self.posed.camera.height)
        return np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_AREA) == 255)


@torch.no_grad()
def refined_membership(
    owners: Owners,
    shares: F32,
    gaussians: Gaussians,
    views: Sequence[MaskedView],
    size: F32,
    settings: DiscoverySettings,
    backend: Backend = "cpu",
) -> Evidence:
    """Counts for each Gaussian the pixels of each object that it contributes to.

    Each of `refinement_rounds` rounds renders the objects by the last membership. The grouping counts as one pixel.
    Labels are numbers of objects from 1; 0 is no object.

    Args:
        owners: int32 [G], number of the object of each Gaussian.
        shares: float32 [G], its certainty, 0..1.
        views: those that have masks.
        size: float32 [G], see `Overlaps`.
    """
    grouped = membership_of(np.arange(len(owners)), owners + 1, shares, len(owners), pixels=1)
    count = int(owners.max(initial=NOBODY)) + 1
    evidence = grouped
    splats = splats_of(gaussians, device=device_of(backend))
    for _ in range(settings.refinement_rounds if count else 0):
        blend = EvidenceBlend(evidence, count + 1, splats.means.device)
        parts = [grouped]
        for view in views:
            viewmat = torch.from_numpy(view.posed.camera_from_world().astype(np.float32)).to(splats.means.device)
            drawn = blend.render(splats, viewmat, view.posed.camera, alpha_min=0.5, relevancy=None, backend=backend)
            labels = repainted(drawn.classes.cpu().numpy(), view.masks(), min_overlap=settings.min_overlap)
            content = view.valid()
            says = labels != UNKNOWN if content is None else (labels != UNKNOWN) & content
            labels[~says] = 0
            parts.append(view_evidence(gaussians, view.posed, labels, count + 1, valid=says, backend=backend))
            if sum(len(part.labels) for part in parts[1:]) > _PENDING_ENTRIES:
                parts = [merged(parts)]
        evidence = _without_strays(merged(parts), gaussians, size)
    return _without_holes(evidence, gaussians, size) if settings.refinement_rounds else evidence


def repainted(object_map: NDArray[np.integer], masks: NDArray[np.bool_], *, min_overlap: float) -> NDArray[np.int32]:
    """Replaces rendered objects of a view by their masks; returns int32 [H, W].

    Each object takes the mask with the highest overlap, if at least `min_overlap`, not counting parts hidden by smaller
    objects; otherwise it stays as rendered. Smaller objects lie on top. Pixels of an object that its mask leaves out
    and no other object takes are `UNKNOWN`.

    Args:
        object_map: int [H, W], rendered object of each pixel, from 1; 0 is none.
        masks: bool [P, H, W].
    """
    count = int(object_map.max(initial=0)) + 1
    areas = np.bincount(object_map.ravel(), minlength=count)
    inside = np.array([np.bincount(object_map[mask], minlength=count) for mask in masks]).reshape(-1, count)
    whole = inside.sum(axis=1)
    result = np.where(object_map == 0, 0, UNKNOWN).astype(np.int32)
    order = [obj for obj in np.argsort(-areas, kind="stable").tolist() if obj and areas[obj]]
    smaller = inside[:, order].sum(axis=1)
    for obj in order:
        smaller = smaller - inside[:, obj]
        union = whole + areas[obj] - inside[:, obj] - smaller
        overlap = inside[:, obj] / np.maximum(union, 1)
        matched = len(masks) and areas[obj] >= _SEEN_PX and overlap.max() >= min_overlap
        result[masks[int(overlap.argmax())] if matched else object_map == obj] = obj
    return result


def _without_strays(evidence: Evidence, gaussians: Gaussians, size: F32) -> Evidence:
    """Removes the evidence of stray Gaussians for their object."""
    count = int(evidence.labels.max(initial=0)) + 1
    owners = posterior(evidence, count).classes - 1
    cleaned = without_strays(owners, gaussians, size, STRAY_SHARE)
    rows = np.repeat(np.arange(len(evidence)), np.diff(evidence.starts))
    stray = (owners != cleaned)[rows] & (evidence.labels == owners[rows] + 1)
    return evidence_of(rows, np.where(stray, 0, evidence.labels), evidence.counts, len(evidence))


def _without_holes(evidence: Evidence, gaussians: Gaussians, size: F32) -> Evidence:
    """Assigns holes of masks, such as patterns on a table, to the surrounding object."""
    count = int(evidence.labels.max(initial=0)) + 1
    owners = posterior(evidence, count).classes - 1
    filled = with_neighbors(owners, gaussians, size, FILLING_NEIGHBORS)
    rows = np.repeat(np.arange(len(evidence)), np.diff(evidence.starts))
    joins = ((owners == NOBODY) & (filled != NOBODY))[rows] & (evidence.labels == 0)
    return evidence_of(rows, np.where(joins, filled[rows] + 1, evidence.labels), evidence.counts, len(evidence))
