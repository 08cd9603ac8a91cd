"""Membership by pixels: things are drawn in every view, each takes the mask that it matches there, and every Gaussian
counts the pixels of each thing that it is seen through. A vote of views on whole Gaussians is rougher."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image as PillowImage

from fastsplat.service.instances.ownership import (
    FILLING_NEIGHBORS,
    NOBODY,
    STRAY_SHARE,
    Owners,
    membership_of,
    with_neighbors,
    without_strays,
)
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.perception.types import ViewMasks
from fastsplat.service.scene.label_evidence import evidence_of, merged, posterior
from fastsplat.service.scene.types import F32, Evidence, Gaussians
from fastsplat.service.splatting.blending import EvidenceBlend
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.types import Backend
from fastsplat.service.splatting.view_evidence import view_evidence
from fastsplat_contract.camera import PosedCamera

_SEEN_PX = 16
"""Things that fill fewer pixels of a view take no mask there."""
UNKNOWN = -1
"""Of a pixel that says nothing."""


_PENDING_ENTRIES = 1 << 21
"""Evidence of several views is merged from so many entries on: about 50 bytes each."""


@dataclass(frozen=True)
class MaskedView:
    """A view at the size at which masks are lifted; masks stay packed until they are read.

    Attributes:
        proposals: masks without names.
        valid_path: the picture of the pixels that have content; None when all do.
    """

    posed: PosedCamera
    proposals: ViewMasks
    valid_path: Path | None = None

    def masks(self) -> NDArray[np.bool_]:
        """bool [P, H, W]."""
        return self.proposals.resized(self.posed.camera.width, self.posed.camera.height)

    def valid(self) -> NDArray[np.bool_] | None:
        """bool [H, W], pixels that have content; None when all do."""
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
    """The pixels of each thing that every Gaussian is seen through, in `refinement_rounds` rounds: the membership of
    one draws the things of the next. What the grouping said stays as one pixel of evidence.

    Args:
        owners: of G Gaussians, numbers of T things.
        shares: float32 [G], how sure that is, 0..1.
        gaussians: G of them.
        views: those that have masks.
        size: float32 [G], see `Overlaps`.
        settings: rounds, and the least overlap of a thing with its mask.

    Returns:
        Labels are numbers of things from 1; 0 is no thing.
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


def repainted(shown: NDArray[np.integer], masks: NDArray[np.bool_], *, min_overlap: float) -> NDArray[np.int32]:
    """The things of a view by their masks: int32 [H, W], numbers from 1, 0 for none, `UNKNOWN` where a thing was drawn
    that its mask leaves out and no other has.

    Each thing takes the mask that overlaps it most, by at least `min_overlap`, beside what smaller things hide; without
    one it stays as drawn. The smaller lies on the larger.

    Args:
        shown: int [H, W], the drawn thing of each pixel.
        masks: bool [P, H, W].
        min_overlap: 0..1.
    """
    count = int(shown.max(initial=0)) + 1
    areas = np.bincount(shown.ravel(), minlength=count)
    inside = np.array([np.bincount(shown[mask], minlength=count) for mask in masks]).reshape(-1, count)
    whole = inside.sum(axis=1)
    result = np.where(shown == 0, 0, UNKNOWN).astype(np.int32)
    order = [thing for thing in np.argsort(-areas, kind="stable").tolist() if thing and areas[thing]]
    smaller = inside[:, order].sum(axis=1)
    for thing in order:
        smaller = smaller - inside[:, thing]
        union = whole + areas[thing] - inside[:, thing] - smaller
        overlap = inside[:, thing] / np.maximum(union, 1)
        matched = len(masks) and areas[thing] >= _SEEN_PX and overlap.max() >= min_overlap
        result[masks[int(overlap.argmax())] if matched else shown == thing] = thing
    return result


def _without_strays(evidence: Evidence, gaussians: Gaussians, size: F32) -> Evidence:
    """The same evidence, less that of a Gaussian for its thing where it is a stray of it."""
    count = int(evidence.labels.max(initial=0)) + 1
    owners = posterior(evidence, count).classes - 1
    cleaned = without_strays(owners, gaussians, size, STRAY_SHARE)
    rows = np.repeat(np.arange(len(evidence)), np.diff(evidence.starts))
    stray = (owners != cleaned)[rows] & (evidence.labels == owners[rows] + 1)
    return evidence_of(rows, np.where(stray, 0, evidence.labels), evidence.counts, len(evidence))


def _without_holes(evidence: Evidence, gaussians: Gaussians, size: F32) -> Evidence:
    """The same evidence, where what speaks for nothing in a Gaussian that no thing has speaks for the thing of its
    nearest neighbors: masks have holes, such as a pattern on a table, where their things have none."""
    count = int(evidence.labels.max(initial=0)) + 1
    owners = posterior(evidence, count).classes - 1
    filled = with_neighbors(owners, gaussians, size, FILLING_NEIGHBORS)
    rows = np.repeat(np.arange(len(evidence)), np.diff(evidence.starts))
    joins = ((owners == NOBODY) & (filled != NOBODY))[rows] & (evidence.labels == 0)
    return evidence_of(rows, np.where(joins, filled[rows] + 1, evidence.labels), evidence.counts, len(evidence))
