"""The rows of a splat file as arrays, before they are anybody's scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

Y00 = 0.28209479177387814
"""The constant real spherical harmonic: ½ √(1/π)."""

SH_COUNTS = (1, 4, 9, 16)
"""Coefficients of a color by the degree of its harmonics, 0 to 3."""

SH_OF_REST = {3 * (count - 1): count for count in SH_COUNTS}
"""Coefficients of a color by the number of f_rest properties."""


def logits(stored: NDArray[np.uint8]) -> F32:
    """float32 logits of opacities in bytes, ±inf for 0 and 255."""
    shares = stored.astype(np.float32) / 255
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(shares) - np.log1p(-shares))


@dataclass(frozen=True)
class SplatRows:
    """G Gaussians in a file's order, before activation; conventions and units of `service.scene.types.Gaussians`.

    Attributes:
        means: float32 [G, 3], world frame.
        quats: float32 [G, 4], w x y z.
        log_scales: float32 [G, 3].
        logit_opacities: float32 [G].
        sh: float32 [G, K, 3], coefficient 0 first.
    """

    means: F32
    quats: F32
    log_scales: F32
    logit_opacities: F32
    sh: F32

    @classmethod
    def empty(cls, count: int, sh_count: int) -> Self:
        """`count` rows whose numbers are yet to be written."""
        return cls(
            means=np.empty((count, 3), np.float32),
            quats=np.empty((count, 4), np.float32),
            log_scales=np.empty((count, 3), np.float32),
            logit_opacities=np.empty(count, np.float32),
            sh=np.empty((count, sh_count, 3), np.float32),
        )

    def __len__(self) -> int:
        return len(self.means)
