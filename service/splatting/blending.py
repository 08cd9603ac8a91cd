"""Maps of labels and of things in one view: blended codes under the affine map, or blended posterior probabilities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.scene.label_evidence import posterior
from fastsplat.service.scene.types import F32, Evidence, Scene, SemanticHead, ThingSemantics, semantics_of
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster import (
    Backend,
    LabelMap,
    Rendering,
    Splats,
    device_of,
    label_map,
    rasterize_bands,
)
from fastsplat_contract.camera import Camera, PosedCamera
from fastsplat_contract.errors import InvalidInputError

_CHANNELS = 32
"""Labels of one rasterization: twice the channels take a fifth more time, up to about here."""

_BAND_VALUES = 8 << 20
"""Numbers of label probabilities in memory at a time."""


class LabelBlend(Protocol):
    """Draws label maps of a scene."""

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
        """Labels and, with [N + 1] `relevancy`, its expectation times alpha; `splats.features` come back as `image`."""


def label_blend(scene: Scene, device: torch.device) -> LabelBlend:
    """By the scene's codes, its evidence or its things, as its `label_mode` says."""
    semantics = semantics_of(scene)
    if isinstance(semantics, ThingSemantics):
        return ThingBlend(semantics, device)
    if isinstance(semantics, Evidence):
        return EvidenceBlend(semantics, len(scene.dictionary) + 1, device)
    return CodeBlend(semantics.codes, semantics.head, device)


@torch.no_grad()
def thing_map(
    scene: Scene, posed: PosedCamera, *, alpha_min: float = 0.5, backend: Backend = "cpu"
) -> NDArray[np.int32]:
    """int32 [H, W]: id of the most probable thing of each pixel, 0 for none and where the scene is less opaque than
    `alpha_min`; the blended posterior of membership, as `EvidenceBlend` draws labels.

    Raises:
        InvalidInputError: a scene without things.
    """
    if scene.things is None:
        raise InvalidInputError("this scene has no things", field="things", hint="Discover them first.")
    device = device_of(backend)
    classes = max((thing.id for thing in scene.things.table), default=0) + 1
    blend = EvidenceBlend(scene.things.membership, classes, device)
    viewmat = torch.from_numpy(posed.camera_from_world().astype(np.float32)).to(device)
    drawn = blend.render(
        splats_of(scene.gaussians, device=device),
        viewmat,
        posed.camera,
        alpha_min=alpha_min,
        relevancy=None,
        backend=backend,
    )
    return np.asarray(drawn.classes.cpu().numpy(), np.int32)


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
        labels = label_map(
            replace(splats, features=torch.cat([splats.features, self._codes], dim=1)),
            viewmat,
            camera,
            self._weight,
            self._bias,
            alpha_min=alpha_min,
            relevancy=None if relevancy is None else torch.tensor(relevancy, device=self._weight.device),
            backend=backend,
        )
        if labels.relevancy is None:
            return labels
        return replace(labels, relevancy=labels.relevancy * labels.alpha)


class EvidenceBlend:
    """argmax_n of P(n) = Σ_g w_g A[g, n] / (Σ A[g] + α0), the blended posterior without its even part.

    Gaussians that no labeled view has seen do not count. Of two labels that are equally probable the lower id wins.
    Many labels are blended in pieces, only those of the Gaussians in view, and all in bands of rows: memory beside the
        result grows
    neither with the dictionary nor with the image.

    Args:
        evidence: of G Gaussians.
        classes: N + 1.
        device: where the Gaussians are.
    """

    def __init__(self, evidence: Evidence, classes: int, device: torch.device) -> None:
        self.evidence = evidence
        mean = posterior(evidence, classes)
        rows = np.repeat(np.arange(len(evidence)), np.diff(evidence.starts))
        order = np.argsort(evidence.labels, kind="stable")
        self._count = len(evidence)
        self._rows = rows[order]
        self._labels = evidence.labels[order]
        self._shares = (mean.probability - mean.rest[rows])[order]
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
        expected = splats.means.new_zeros(self._count, 0)
        if relevancy is not None:
            sums = np.bincount(self._rows, self._shares * relevancy[self._labels], self._count)
            expected = torch.tensor(sums, dtype=splats.means.dtype, device=self._device)[:, None]
        names, table = self._few or (np.zeros(0, np.uint16), splats.means.new_zeros(self._count, 0))
        canvas = _Canvas(splats, viewmat, camera, backend)
        radii = canvas.draw_first(torch.cat([splats.features, expected], dim=1), names, table)
        if not self._few:
            for piece in self._in_view(radii):
                canvas.draw_labels(piece, self._table(piece))
        own = splats.features.shape[1]
        return LabelMap(
            classes=torch.where(canvas.alpha >= alpha_min, canvas.classes, 0),
            alpha=canvas.alpha,
            relevancy=None if relevancy is None else canvas.image[..., own],
            image=canvas.image[..., :own],
            culled_non_finite=canvas.culled_non_finite,
        )

    def _in_view(self, radii: Tensor) -> list[NDArray[np.uint16]]:
        """The labels of visible Gaussians, ascending, in pieces of one rasterization."""
        visible = np.asarray(radii.cpu().numpy()) > 0
        names = np.unique(self._labels[visible[self._rows]])
        return [names[start : start + _CHANNELS] for start in range(0, len(names), _CHANNELS)]

    def _table(self, names: NDArray[np.uint16]) -> Tensor:
        """float32 [G, K]: the probability of these consecutive labels."""
        table = np.zeros((self._count, len(names)), np.float32)
        if len(names):
            entries = slice(*np.searchsorted(self._labels, [names[0], int(names[-1]) + 1]))
            columns = np.searchsorted(names, self._labels[entries])
            known = names[np.minimum(columns, len(names) - 1)] == self._labels[entries]
            table[self._rows[entries][known], columns[known]] = self._shares[entries][known]
        return torch.tensor(table, device=self._device)


class ThingBlend:
    """The name of the most probable thing of each pixel, see `EvidenceBlend`: a label's mask is the union of the masks
    of the things that bear it.

    Args:
        semantics: of G Gaussians.
        device: where the Gaussians are.
        things: draws the things themselves; None: made of `semantics`.

    Attributes:
        things: see above.
    """

    def __init__(self, semantics: ThingSemantics, device: torch.device, things: EvidenceBlend | None = None) -> None:
        self._label_ids = semantics.label_ids
        self.things = things or EvidenceBlend(semantics.membership, len(semantics.label_ids), device)

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
        drawn = self.things.render(
            splats,
            viewmat,
            camera,
            alpha_min=alpha_min,
            relevancy=None if relevancy is None else relevancy[self._label_ids],
            backend=backend,
        )
        label_ids = torch.tensor(self._label_ids, device=drawn.classes.device)
        return replace(drawn, classes=label_ids[drawn.classes.long()])


class _Canvas:
    """A view while labels are drawn into it, in bands of rows.

    Attributes:
        image: [H, W, C], the leading channels.
        alpha: [H, W].
        classes: int32 [H, W], the label whose probability is largest so far, 0 where none is above 0.
        culled_non_finite: see `LabelMap`.
    """

    def __init__(self, splats: Splats, viewmat: Tensor, camera: Camera, backend: Backend) -> None:
        shape = (camera.height, camera.width)
        self._splats, self._viewmat, self._camera, self._backend = splats, viewmat, camera, backend
        self._best = splats.means.new_zeros(shape)
        self.image = splats.means.new_zeros(*shape, 0)
        self.alpha = splats.means.new_zeros(shape)
        self.classes = torch.zeros(shape, dtype=torch.int32, device=splats.means.device)
        self.culled_non_finite = 0

    def draw_first(self, leading: Tensor, names: NDArray[np.uint16], table: Tensor) -> Tensor:
        """Draws alpha, `leading` [G, C] as the image, and labels as `draw_labels`; returns the radii, int32 [G]."""
        channels = leading.shape[1]
        radii = torch.zeros(len(leading), dtype=torch.int32)
        self.image = leading.new_empty(*self.alpha.shape, channels)
        for band, rendering in self._bands(torch.cat([leading, table], dim=1)):
            self.image[band], self.alpha[band] = rendering.image[..., :channels], rendering.alpha
            self._update(band, names, rendering.image[..., channels:])
            radii, self.culled_non_finite = rendering.radii, rendering.culled_non_finite
        return radii

    def draw_labels(self, names: NDArray[np.uint16], table: Tensor) -> None:
        """Draws the labels `names` [K] with probabilities `table` [G, K]."""
        for band, rendering in self._bands(table):
            self._update(band, names, rendering.image)

    def _bands(self, features: Tensor) -> Iterator[tuple[slice, Rendering]]:
        splats = replace(self._splats, features=features)
        return rasterize_bands(splats, self._viewmat, self._camera, max_values=_BAND_VALUES, backend=self._backend)

    def _update(self, band: slice, names: NDArray[np.uint16], shares: Tensor) -> None:
        """Sets the class to the label whose share [rows, W, K] is larger than all before."""
        if not len(names):
            return
        column = shares.argmax(dim=2, keepdim=True)  # the first of equals, which `max` does not promise
        share = shares.gather(2, column)[..., 0]
        named = torch.tensor(names.astype(np.int32), device=shares.device)[column[..., 0]]
        larger = share > self._best[band]
        self._best[band] = torch.where(larger, share, self._best[band])
        self.classes[band] = torch.where(larger, named, self.classes[band])
