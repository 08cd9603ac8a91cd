"""Gaussians of an object prompted in one view, segmented there and in further views."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.instances.prompt_answers import PicturePrompt, matching_mask, prompted_mask
from fastsplat.service.perception.results import Segmenter
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.scene.gaussians.connectivity import components
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.raster.rendering import label_sums, rasterize
from fastsplat_contract.geometry.camera import PosedCamera

Mask = NDArray[np.bool_]
F64 = NDArray[np.float64]
Rows = NDArray[np.int64]

_SEEN_PX = 0.05  # least weight for a view to see a Gaussian
_INSIDE = 0.5  # share of a Gaussian's weight in all views that must lie in the masks
_NEIGHBORS = 8
_STRAY = 0.1  # disconnected parts lighter than this share of the piece's largest part are removed


@dataclass(frozen=True)
class PromptedScene:
    """The scene and models that answer a prompt."""

    gaussians: Gaussians
    region: Mask | None  # [G], the object to be split; None for a missing object, which may have all Gaussians
    segmenter: Segmenter
    embed: Callable[[PosedCamera], Any]  # embedding of a view's picture, see `Segmenter.embed`
    further: Callable[[Rows], Sequence[PosedCamera]]  # other cameras that show Gaussians well, best first
    backend: Backend = "cpu"


@dataclass(frozen=True)
class Piece:
    """Gaussians selected by a prompt."""

    rows: Rows  # [K], ascending; empty if nothing of the region is shown there
    views: tuple[PosedCamera, ...]  # with agreeing masks, the prompt's first


@torch.no_grad()
def find_piece(scene: PromptedScene, posed: PosedCamera, prompt: PicturePrompt, ids: NDArray[np.integer]) -> Piece:
    """Finds the Gaussians of the region that a prompt in one view selects.

    They have more than half of their weight in the prompt's mask (FlashSplat, Shen et al. 2024). The piece is rendered
    in further views, where the best matching answer votes with the same weights and removes what hides behind the mask.
    Gaussians that no view sees follow their neighbors.

    Args:
        prompt: in pixels of `posed`.
        ids: int [H, W], the object of each pixel of that view, 0 for none.

    Raises:
        CancelledError: see `service.common.cancellation`.
    """
    votes = _Votes(scene)
    segmenter = scene.segmenter
    answer = segmenter.mask_logits(scene.embed(posed), prompt.prompts())
    inside = None if scene.region is None else votes.drawn(posed)[..., 2] > _INSIDE
    mask = prompted_mask(answer, prompt, ids, inside)
    if mask is None:
        return Piece(np.zeros(0, np.int64), ())
    votes.add(posed, mask)
    first = np.flatnonzero(votes.piece)
    for view in scene.further(first) if len(first) else ():
        check_cancelled()
        shares = votes.drawn(view)
        again = matching_mask(segmenter, partial(scene.embed, view), shares)
        if again is not None:
            votes.add(view, again)
    return Piece(np.flatnonzero(votes.settled()), tuple(votes.views))


class _Votes:
    """Weights of Gaussians inside the masks of views, and in total."""

    def __init__(self, scene: PromptedScene) -> None:
        self._gaussians = scene.gaussians
        self._region = np.ones(len(scene.gaussians), np.bool_) if scene.region is None else scene.region
        self._backend = scene.backend
        self._splats = splats_of(scene.gaussians, device=device_of(scene.backend))
        self._inside = np.zeros(len(scene.gaussians))
        self._total = np.zeros(len(scene.gaussians))
        self.views: list[PosedCamera] = []

    def add(self, posed: PosedCamera, mask: Mask) -> None:
        """Adds the weights of a view with the mask bool [H, W] of the piece."""
        image = torch.from_numpy(mask.astype(np.int32)).to(self._splats.means.device)
        sums = label_sums(self._splats, self._viewmat(posed), posed.camera, image, 2, backend=self._backend)
        weights = sums.dense(2).cpu().numpy()
        self._inside += weights[:, 1]
        self._total += weights.sum(axis=1)
        self.views.append(posed)

    @property
    def _seen(self) -> Mask:
        return self._total > _SEEN_PX

    @property
    def piece(self) -> Mask:
        """bool [G]: in the region, and with most of the weight inside the masks."""
        return self._region & self._seen & (self._inside > _INSIDE * self._total)

    def drawn(self, posed: PosedCamera) -> NDArray[np.float32]:
        """Renders pixel shares, float32 [H, W, 3]: piece, known other, seen by no view."""
        piece, seen = self.piece, self._seen
        outside = ~piece & (seen | ~self._region)
        features = np.stack([piece, outside, ~piece & ~outside], axis=1).astype(np.float32)
        splats = replace(self._splats, features=torch.from_numpy(features).to(self._splats.means.device))
        rendering = rasterize(splats, self._viewmat(posed), posed.camera, backend=self._backend)
        return np.asarray(rendering.image.cpu().numpy())

    def settled(self) -> Mask:
        """bool [G]: the piece with unseen Gaussians of the region and without strays."""
        piece, means = self.piece, self._gaussians.means
        finite = np.isfinite(means).all(axis=1)
        known = np.flatnonzero(self._region & self._seen & finite)
        unseen = np.flatnonzero(self._region & ~self._seen & finite)
        count = min(_NEIGHBORS, len(known))
        if count and len(unseen) and piece.any():
            near = cKDTree(means[known]).query(means[unseen], [*range(1, count + 1)])[1]
            piece[unseen] = piece[known[near]].mean(axis=1) > _INSIDE
        rows = np.flatnonzero(piece & finite)
        if len(rows):
            part = components(self._gaussians, rows)
            weights = np.bincount(part, self._total[rows])
            piece[rows[(weights < _STRAY * weights.max())[part]]] = False
        return piece

    def _viewmat(self, posed: PosedCamera) -> torch.Tensor:
        return torch.from_numpy(posed.camera_from_world().astype(np.float32)).to(self._splats.means.device)
