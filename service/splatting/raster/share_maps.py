"""Label maps from sparse label probabilities per Gaussian."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.scene.artefact.scene import F32
from fastsplat.service.splatting.raster import cpu
from fastsplat.service.splatting.raster.checks import check_call
from fastsplat.service.splatting.raster.image_formation import Backend, LabelMap, RasterSettings, Splats
from fastsplat.service.splatting.raster.rendering import rasterize_bands
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera

_DEFAULTS = RasterSettings()

_CHANNELS = 32
"""Labels per rasterization: doubling takes a fifth more time, up to about here."""

_BAND_VALUES = 8 << 20  # label probabilities in memory at a time


class ShareMaps:
    """Renders argmax_n Σ_g w_g share[g, n], ties to the lower label; thread-safe.

    0 where no sum is positive. On `cpu` a tile sums only the labels of its own Gaussians; other backends blend 32
    labels at a time in row bands. Memory beside the result grows with neither label count nor image size.

    Args:
        starts: int64 [G + 1]; Gaussian g has the entries starts[g]..starts[g + 1] of the other two.
        labels: uint16 [M].
        shares: float32 [M], finite.

    >>> splats = Splats(torch.tensor([[0, 0, 2.0]]), torch.eye(1, 4), torch.ones(1, 3), torch.ones(1), torch.ones(1, 3))
    >>> maps = ShareMaps(np.array([0, 2]), np.array([3, 7], np.uint16), np.array([0.4, 0.6], np.float32))
    >>> maps.draw(splats, torch.eye(4), Camera(4, 2, fx=4.0, fy=4.0, cx=2.0, cy=1.0), alpha_min=0.9).classes[0]
    tensor([0, 7, 7, 0], dtype=torch.int32)
    """

    def __init__(self, starts: NDArray[np.int64], labels: NDArray[np.uint16], shares: F32) -> None:
        if len(labels) != len(shares) or not len(starts) or starts[-1] != len(labels) or not np.isfinite(shares).all():
            raise InvalidInputError(
                f"{len(labels)} labels and {len(shares)} shares of {len(starts) - 1} Gaussians", field="shares"
            )
        self._starts = np.ascontiguousarray(starts)
        self._labels = np.ascontiguousarray(labels)
        self._shares = np.ascontiguousarray(shares)

    def draw(
        self,
        splats: Splats,
        viewmat: Tensor,
        camera: Camera,
        *,
        alpha_min: float,
        settings: RasterSettings = _DEFAULTS,
        backend: Backend = "cpu",
    ) -> LabelMap:
        """Renders a view's labels without gradient, 0 where alpha is below `alpha_min`.

        Raises as `rendering.rasterize`, and InvalidInputError for another number of Gaussians.
        """
        plain = replace(splats, features=splats.means.new_zeros(len(splats.means), 0))
        check_call(plain, viewmat, camera, settings)
        if len(splats.means) != len(self._starts) - 1:
            raise InvalidInputError(
                f"{len(splats.means)} Gaussians and shares of {len(self._starts) - 1}", field="splats"
            )
        with torch.no_grad():
            if backend == "cpu":
                return cpu.share_map(
                    plain, viewmat, camera, self._starts, self._labels, self._shares, alpha_min, settings
                )
            canvas = _Canvas(plain, viewmat, camera, settings, backend)
            radii = canvas.draw_labels(np.zeros(0, np.uint16), self._table(np.zeros(0, np.uint16), plain))
            for names in self._in_view(radii):
                canvas.draw_labels(names, self._table(names, plain))
        alpha = canvas.alpha
        classes, image = torch.where(alpha >= alpha_min, canvas.classes, 0), alpha.new_zeros(*alpha.shape, 0)
        return LabelMap(classes, alpha, None, image, canvas.culled_non_finite)

    @cached_property
    def _by_label(self) -> tuple[NDArray[np.int64], NDArray[np.uint16], F32]:
        """Gaussian, label and share of all entries, by ascending label."""
        rows = np.repeat(np.arange(len(self._starts) - 1), np.diff(self._starts))
        order = np.argsort(self._labels, kind="stable")
        return rows[order], self._labels[order], self._shares[order]

    def _in_view(self, radii: Tensor) -> list[NDArray[np.uint16]]:
        """Labels of visible Gaussians, ascending, in chunks of `_CHANNELS`."""
        rows, labels, _ = self._by_label
        visible = np.asarray(radii.cpu().numpy()) > 0
        names = np.unique(labels[visible[rows]])
        return [names[start : start + _CHANNELS] for start in range(0, len(names), _CHANNELS)]

    def _table(self, names: NDArray[np.uint16], splats: Splats) -> Tensor:
        """Shares of these ascending labels as a dense table, [G, K]."""
        table = np.zeros((len(self._starts) - 1, len(names)), np.float32)
        if len(names):
            rows, labels, shares = self._by_label
            entries = slice(*np.searchsorted(labels, [names[0], int(names[-1]) + 1]))
            columns = np.searchsorted(names, labels[entries])
            known = names[np.minimum(columns, len(names) - 1)] == labels[entries]
            table[rows[entries][known], columns[known]] = shares[entries][known]
        return torch.tensor(table, dtype=splats.means.dtype, device=splats.means.device)


class _Canvas:
    """Accumulates the label map of a view, in row bands."""

    def __init__(
        self, splats: Splats, viewmat: Tensor, camera: Camera, settings: RasterSettings, backend: Backend
    ) -> None:
        shape = (camera.height, camera.width)
        given = partial(rasterize_bands, viewmat=viewmat, camera=camera, settings=settings, backend=backend)
        self._splats, self._bands = splats, partial(given, max_values=_BAND_VALUES)
        self._best = splats.means.new_zeros(shape)
        self.alpha = splats.means.new_zeros(shape)
        # Label of the largest sum so far, 0 where none is positive.
        self.classes = torch.zeros(shape, dtype=torch.int32, device=splats.means.device)
        self.culled_non_finite = 0

    def draw_labels(self, names: NDArray[np.uint16], table: Tensor) -> Tensor:
        """Draws alpha and labels [K] with shares [G, K]; returns the radii, int32 [G]."""
        radii = torch.zeros(len(table), dtype=torch.int32)
        for band, rendering in self._bands(replace(self._splats, features=table)):
            self.alpha[band] = rendering.alpha
            self._update(band, names, rendering.image)
            radii, self.culled_non_finite = rendering.radii, rendering.culled_non_finite
        return radii

    def _update(self, band: slice, names: NDArray[np.uint16], shares: Tensor) -> None:
        """Updates classes where a share [rows, W, K] exceeds all before."""
        if not len(names):
            return
        column = shares.argmax(dim=2, keepdim=True)  # the first of equals, which `max` does not guarantee
        share = shares.gather(2, column)[..., 0]
        named = torch.tensor(names.astype(np.int32), device=shares.device)[column[..., 0]]
        larger = share > self._best[band]
        self._best[band] = torch.where(larger, share, self._best[band])
        self.classes[band] = torch.where(larger, named, self.classes[band])
