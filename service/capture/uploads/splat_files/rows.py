"""Rows of a splat file as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

Y00 = 0.28209479177387814  # constant real spherical harmonic, ½ √(1/π)

SH_COUNTS = (1, 4, 9, 16)  # coefficients of a color by degree, 0 to 3

SH_OF_REST = {3 * (count - 1): count for count in SH_COUNTS}
"""Coefficients of a color by the number of f_rest properties."""


def logits(stored: NDArray[np.uint8]) -> F32:
    """Converts opacity bytes to logits, ±inf for 0 and 255."""
    shares = stored.astype(np.float32) / 255
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(shares) - np.log1p(-shares))


@dataclass(frozen=True)
class SplatRows:
    """G Gaussians in file order, before activation, as in `service.scene.artefact.scene.Gaussians`."""

    means: F32  # [G, 3], world frame
    quats: F32  # [G, 4], w x y z
    log_scales: F32  # [G, 3]
    logit_opacities: F32  # [G]
    sh: F32  # [G, K, 3], coefficient 0 first

    @classmethod
    def empty(cls, count: int, sh_count: int) -> Self:
        """Allocates `count` uninitialized rows."""
        return cls(
            means=np.empty((count, 3), np.float32),
            quats=np.empty((count, 4), np.float32),
            log_scales=np.empty((count, 3), np.float32),
            logit_opacities=np.empty(count, np.float32),
            sh=np.empty((count, sh_count, 3), np.float32),
        )

    def __len__(self) -> int:
        return len(self.means)
