"""What somebody points at in one view, as Gaussians: segmented there, and in further views that show it."""

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
from fastsplat.service.perception.types import Segmenter
from fastsplat.service.scene.connectivity import components
from fastsplat.service.scene.types import Gaussians
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.rendering import label_sums, rasterize
from fastsplat.service.splatting.raster.types import Backend
from fastsplat_contract.camera import PosedCamera

Mask = NDArray[np.bool_]
F64 = NDArray[np.float64]
Rows = NDArray[np.int64]

_SEEN_PX = 0.05
"""A view says nothing of Gaussians that fill fewer pixels of it."""
_INSIDE = 0.5
"""Share of its weight in all views that must lie in the masks for a Gaussian to belong to the piece."""
_NEIGHBORS = 8
_STRAY = 0.1
"""Parts of the piece that touch nothing of it and weigh less than this share of its largest part are left out."""


@dataclass(frozen=True)
class PromptedScene:
    """What a prompt is answered with.

    Attributes:
        gaussians: G of them.
        region: bool [G]: the thing that a piece is cut out of; None for a missing thing, which may have all Gaussians.
        embed: what the segmenter needs to know of the picture of a view, see `Segmenter.embed`.
        further: cameras that show Gaussians (their rows) well, other than the one that was prompted in, best first; of
            the size that pictures have.
    """

    gaussians: Gaussians
    region: Mask | None
    segmenter: Segmenter
    embed: Callable[[PosedCamera], Any]
    further: Callable[[Rows], Sequence[PosedCamera]]
    backend: Backend = "cpu"


@dataclass(frozen=True)
class Piece:
    """Gaussians that a prompt shows.

    Attributes:
        rows: int64 [K], ascending; none where the picture shows nothing of the region there.
        views: the cameras whose masks agree, the prompt's first.
    """

    rows: Rows
    views: tuple[PosedCamera, ...]


@torch.no_grad()
def find_piece(scene: PromptedScene, posed: PosedCamera, prompt: PicturePrompt, ids: NDArray[np.integer]) -> Piece:
    """The Gaussians of the region that a prompt in one view shows.

    A Gaussian is in the piece if more than half of its weight lies in the prompt's mask (FlashSplat, Shen et al. 2024).
    The piece is drawn in further views, where the best answer to what is drawn votes with the same weights and cuts off
    what hides behind the mask. Gaussians that no view sees follow their neighbors.

    Args:
        prompt: in pixels of that size.
        ids: int [H, W] the thing of each pixel of that view, 0 for none.

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
    for other in scene.further(first) if len(first) else ():
        check_cancelled()
        shown = votes.drawn(other)
        again = matching_mask(segmenter, partial(scene.embed, other), shown)
        if again is not None:
            votes.add(other, again)
    return Piece(np.flatnonzero(votes.settled()), tuple(votes.views))


class _Votes:
    """The weight of each Gaussian inside the masks of views, and in these views altogether."""

    def __init__(self, scene: PromptedScene) -> None:
        self._gaussians = scene.gaussians
        self._region = np.ones(len(scene.gaussians), np.bool_) if scene.region is None else scene.region
        self._backend = scene.backend
        self._splats = splats_of(scene.gaussians, device=device_of(scene.backend))
        self._inside = np.zeros(len(scene.gaussians))
        self._total = np.zeros(len(scene.gaussians))
        self.views: list[PosedCamera] = []

    def add(self, posed: PosedCamera, mask: Mask) -> None:
        """Count the weights of one more view, whose piece is bool [H, W]."""
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
        """bool [G]: in the region, and inside the masks by most of its weight."""
        return self._region & self._seen & (self._inside > _INSIDE * self._total)

    def drawn(self, posed: PosedCamera) -> NDArray[np.float32]:
        """float32 [H, W, 3]: the share of each pixel that is of the piece, that is of what is known to be none of it,
        and that is of what no view has seen."""
        piece, seen = self.piece, self._seen
        other = ~piece & (seen | ~self._region)
        features = np.stack([piece, other, ~piece & ~other], axis=1).astype(np.float32)
        splats = replace(self._splats, features=torch.from_numpy(features).to(self._splats.means.device))
        rendering = rasterize(splats, self._viewmat(posed), posed.camera, backend=self._backend)
        return np.asarray(rendering.image.cpu().numpy())

    def settled(self) -> Mask:
        """bool [G]: the piece, with what no view has seen of the region, and without strays."""
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
