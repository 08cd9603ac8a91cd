"""Labels and language on Gaussians that stay as they are: what other methods keep of them, drawn by our rasterizer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.common.logistic import logistic
from fastsplat.service.query.relevancy import LERF_TEMPERATURE
from fastsplat.service.scene.types import F32, Gaussians
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.rendering import rasterize_bands
from fastsplat_contract.camera import PosedCamera

_BAND_VALUES = 1 << 24
_ALPHA_MIN = 0.5
_TINY = 1e-12


@dataclass(frozen=True)
class Vocabulary:
    """What is asked, embedded by one encoder, rows of unit length.

    Attributes:
        labels: float32 [N, E], of the data set's labels; row n − 1 is label id n.
        negatives: float32 [J, E], canonical negatives.
    """

    labels: F32
    negatives: F32


@dataclass(frozen=True)
class DrawnField:
    """One view.

    Attributes:
        label_map: int32 [H, W], label ids, 0 where the view is covered less than half.
        relevancy: float32 [N, H, W], LERF's relevancy of each label's name, 0..1.
    """

    label_map: NDArray[np.int32]
    relevancy: F32


class Field(Protocol):
    """What a method makes of a scene."""

    @property
    def classes(self) -> NDArray[np.int32]:
        """int32 [G]: label id of each Gaussian, 0 for none."""

    def draw(self, posed: PosedCamera) -> DrawnField:
        """Labels and relevancy in one view."""


class FeatureField:
    """A feature a Gaussian, composited and decoded to the text encoder's space in every pixel.

    Args:
        gaussians: G of them.
        features: float32 [G, D]; zeros where nothing is known.
        decoder: float32 [D, E], linear; None: features are of the encoder's space, D = E.
        vocabulary: what is asked.
    """

    def __init__(self, gaussians: Gaussians, features: Tensor, decoder: Tensor | None, vocabulary: Vocabulary) -> None:
        self._splats = splats_of(gaussians, features.contiguous())
        self._decoder = decoder
        self._words = torch.from_numpy(np.concatenate([vocabulary.labels, vocabulary.negatives]))
        self._labels = len(vocabulary.labels)

    @property
    def classes(self) -> NDArray[np.int32]:
        """See `Field`: the label whose name is most alike."""
        features = self._splats.features
        best = self._cosines(features)[:, : self._labels].argmax(dim=1) + 1
        return np.asarray(torch.where(features.abs().sum(dim=1) > 0, best, 0).numpy(), np.int32)

    def draw(self, posed: PosedCamera) -> DrawnField:
        """See `Field`."""
        viewmat = torch.from_numpy(posed.camera_from_world().astype(np.float32))
        cosines, alphas = [], []
        for _, band in rasterize_bands(self._splats, viewmat, posed.camera, max_values=_BAND_VALUES):
            cosines.append(self._cosines(band.image))
            alphas.append(band.alpha)
        cosine, alpha = torch.cat(cosines).numpy(), torch.cat(alphas).numpy()
        labels, negatives = cosine[..., : self._labels], cosine[..., self._labels :]
        margin = np.moveaxis(labels - negatives.max(axis=2, keepdims=True), 2, 0)
        relevancy = logistic(LERF_TEMPERATURE * margin) * (alpha >= _ALPHA_MIN)
        label_map = np.where(alpha >= _ALPHA_MIN, labels.argmax(axis=2) + 1, 0)
        return DrawnField(label_map.astype(np.int32), relevancy.astype(np.float32))

    def _cosines(self, features: Tensor) -> Tensor:
        decoded = features if self._decoder is None else features @ self._decoder
        return decoded @ self._words.T / decoded.norm(dim=-1, keepdim=True).clamp_min(_TINY)


class HardField:
    """A label a Gaussian; a pixel has the label that covers most of it.

    Args:
        gaussians: G of them.
        classes: int [G], label ids, 0 for none.
        vocabulary: what is asked; a pixel is as relevant as its labels are, by their shares of it.
    """

    def __init__(self, gaussians: Gaussians, classes: Sequence[int] | Tensor, vocabulary: Vocabulary) -> None:
        self._classes = torch.as_tensor(classes, dtype=torch.int64)
        one_hot = torch.nn.functional.one_hot(self._classes, len(vocabulary.labels) + 1)[:, 1:]
        self._splats = splats_of(gaussians, one_hot.to(torch.float32).contiguous())
        margin = vocabulary.labels @ vocabulary.labels.T
        margin -= (vocabulary.labels @ vocabulary.negatives.T).max(axis=1, keepdims=True)
        self._relevancy = logistic(LERF_TEMPERATURE * margin).astype(np.float32)  # [N of the pixel, N asked]

    @property
    def classes(self) -> NDArray[np.int32]:
        """See `Field`."""
        return self._classes.numpy().astype(np.int32)

    def draw(self, posed: PosedCamera) -> DrawnField:
        """See `Field`."""
        viewmat = torch.from_numpy(posed.camera_from_world().astype(np.float32))
        bands = list(rasterize_bands(self._splats, viewmat, posed.camera, max_values=_BAND_VALUES))
        shares = torch.cat([band.image for _, band in bands]).numpy()
        alpha = torch.cat([band.alpha for _, band in bands]).numpy()
        covered = (alpha >= _ALPHA_MIN) & (shares.sum(axis=2) > 0)
        label_map = np.where(covered, shares.argmax(axis=2) + 1, 0)
        return DrawnField(label_map.astype(np.int32), np.moveaxis(shares @ self._relevancy, 2, 0))
