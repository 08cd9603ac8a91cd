"""Label maps of a scene in one view: blended codes under the affine map, or blended posterior probabilities."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.scene.evidence import posterior
from fastsplat.service.scene.types import F32, Evidence, Scene, SemanticHead
from fastsplat.service.splatting.raster import Backend, LabelMap, Rendering, Splats, label_map, rasterize
from fastsplat_contract.camera import Camera

_CHANNELS = 32
"""Of one rasterization: twice the channels take a fifth more time, up to about here."""

_IMAGE_VALUES = 16 << 20


class LabelBlend(Protocol):
    """Where the labels of pixels come from."""

    def render(
        self,
        splats: Splats,
        viewmat: Tensor,
        camera: Camera,
        *,
        alpha_min: float,
        relevancy: F32 | None,
        backend: Backend,
    ) -> LabelMap:
        """Labels and, if [N + 1] `relevancy` is given, its expectation times alpha; `splats.features` come back as
        `image`."""


def label_blend(scene: Scene, device: torch.device) -> LabelBlend:
    """By the scene's codes or by its evidence, as its `label_mode` says."""
    if scene.label_mode == "codes" or scene.evidence is None:
        return CodeBlend(scene.gaussians.codes, scene.head, device)
    return EvidenceBlend(scene.evidence, len(scene.dictionary) + 1, device)


class CodeBlend:
    """argmax and softmax of W·code + b of the composited code, not divided by alpha: what the training loss saw.

    Args:
        codes: float32 [G, D].
        head: the affine map.
        device: where to keep both.
    """

    def __init__(self, codes: F32, head: SemanticHead, device: torch.device) -> None:
        self._codes = torch.tensor(np.asarray(codes), device=device)
        self._weight = torch.tensor(np.asarray(head.weight), device=device)
        self._bias = torch.tensor(np.asarray(head.bias), device=device)

    def render(
        self,
        splats: Splats,
        viewmat: Tensor,
        camera: Camera,
        *,
        alpha_min: float,
        relevancy: F32 | None,
        backend: Backend,
    ) -> LabelMap:
        """See `LabelBlend`."""
        found = label_map(
            replace(splats, features=torch.cat([splats.features, self._codes], dim=1)),
            viewmat,
            camera,
            self._weight,
            self._bias,
            alpha_min=alpha_min,
            relevancy=None if relevancy is None else torch.tensor(relevancy, device=self._weight.device),
            backend=backend,
        )
        if found.relevancy is None:
            return found
        return replace(found, relevancy=found.relevancy * found.alpha)


class EvidenceBlend:
    """argmax_n of P(n) = Σ_g w_g A[g, n] / (Σ A[g] + α0), the blended posterior without its even part.

    What no view has seen has no say. Of two labels that are equally probable the lower id wins. Many labels are
    blended in pieces, and only those of the Gaussians in view: memory does not grow with the dictionary.

    Args:
        evidence: of G Gaussians.
        classes: N + 1.
        device: where the Gaussians are.
    """

    def __init__(self, evidence: Evidence, classes: int, device: torch.device) -> None:
        found = posterior(evidence, classes)
        rows = np.repeat(np.arange(len(evidence)), np.diff(evidence.starts))
        order = np.argsort(evidence.labels, kind="stable")
        self._count = len(evidence)
        self._rows = rows[order]
        self._labels = evidence.labels[order]
        self._shares = (found.probability - found.rest[rows])[order]
        self._device = device
        names = np.unique(self._labels)
        self._few = (names, self._table(names)) if len(names) <= _CHANNELS else None

    def render(
        self,
        splats: Splats,
        viewmat: Tensor,
        camera: Camera,
        *,
        alpha_min: float,
        relevancy: F32 | None,
        backend: Backend,
    ) -> LabelMap:
        """See `LabelBlend`."""

        def blended(features: Tensor) -> Rendering:
            return rasterize(replace(splats, features=features), viewmat, camera, backend=backend)

        leading = [splats.features, splats.means.new_zeros(self._count, 1)]
        if relevancy is not None:
            expected = np.bincount(self._rows, self._shares * relevancy[self._labels], self._count)
            leading[1] = torch.tensor(expected, dtype=splats.means.dtype, device=self._device)[:, None]
        first = torch.cat([*leading, self._few[1]] if self._few else leading, dim=1)
        seen = blended(first)
        own = splats.features.shape[1]
        best = torch.zeros_like(seen.alpha)
        classes = torch.zeros_like(seen.alpha, dtype=torch.int32)
        if self._few:
            best, classes = _leader(seen.image[..., own + 1 :], self._few[0], best, classes)
        else:
            for names in self._in_view(seen.radii, camera):
                best, classes = _leader(blended(self._table(names)).image, names, best, classes)
        return LabelMap(
            classes=torch.where(seen.alpha >= alpha_min, classes, 0),
            alpha=seen.alpha,
            relevancy=None if relevancy is None else seen.image[..., own],
            image=seen.image[..., :own],
            culled_non_finite=seen.culled_non_finite,
        )

    def _in_view(self, radii: Tensor, camera: Camera) -> list[NDArray[np.uint16]]:
        """The labels of visible Gaussians, ascending, in pieces whose image stays within `_IMAGE_VALUES`."""
        visible = np.asarray(radii.cpu().numpy()) > 0
        names = np.unique(self._labels[visible[self._rows]])
        size = min(_CHANNELS, max(1, _IMAGE_VALUES // (camera.width * camera.height)))
        return [names[start : start + size] for start in range(0, len(names), size)]

    def _table(self, names: NDArray[np.uint16]) -> Tensor:
        """float32 [G, K]: the probability of these consecutive labels."""
        table = np.zeros((self._count, len(names)), np.float32)
        if len(names):
            chosen = slice(*np.searchsorted(self._labels, [names[0], int(names[-1]) + 1]))
            columns = np.searchsorted(names, self._labels[chosen])
            known = names[np.minimum(columns, len(names) - 1)] == self._labels[chosen]
            table[self._rows[chosen][known], columns[known]] = self._shares[chosen][known]
        return torch.tensor(table, device=self._device)


def _leader(shares: Tensor, names: NDArray[np.uint16], best: Tensor, classes: Tensor) -> tuple[Tensor, Tensor]:
    """The larger of `best` [H, W] and the largest share [H, W, K], and whose it is."""
    if not len(names):
        return best, classes
    column = shares.argmax(dim=2, keepdim=True)  # the first of equals, which `max` does not promise
    share = shares.gather(2, column)[..., 0]
    named = torch.tensor(names.astype(np.int32), device=shares.device)[column[..., 0]]
    larger = share > best
    return torch.where(larger, share, best), torch.where(larger, named, classes)
