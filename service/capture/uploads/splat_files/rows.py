"""Rows of a splat file as arrays, and the refusals that readers share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fastsplat_contract.errors import InvalidInputError, LimitExceededError

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


def smallest_three(place: NDArray[np.intp], smaller: NDArray[np.floating]) -> F32:
    """Completes unit quaternions [K, 4] from the place [K] of the largest component and the others [K, 3], in order."""
    quats, place = np.zeros((len(place), 4), np.float32), place[:, None]
    np.put_along_axis(quats, np.arange(3) + (place <= np.arange(3)), smaller, axis=1)
    np.put_along_axis(quats, place, np.sqrt(np.maximum(0, 1 - (smaller**2).sum(axis=1, keepdims=True))), axis=1)
    return quats


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


@dataclass(frozen=True)
class SplatLimits:
    """Limits of a splat file; `setting` is the environment variable, for messages."""

    max_gaussians: int
    setting: str = ""


def check_count(name: str, count: int, limits: SplatLimits) -> None:
    """Checks a row count before any allocation: at least 1, at most the limit."""
    if count > limits.max_gaussians:
        setting = f" ({limits.setting})" if limits.setting else ""
        raise LimitExceededError.of(
            name,
            f"announces {count} Gaussians",
            "Reduce the splat in an editor, or raise the limit.",
            f"{limits.max_gaussians} Gaussians{setting}",
        )
    if count < 1:
        raise bad_splat(name, "has no Gaussians")


def bad_splat(name: str, problem: str) -> InvalidInputError:
    """Makes the error of a damaged or foreign file."""
    return InvalidInputError.of(
        name,
        problem,
        "Send a 3D Gaussian splatting PLY, a compressed PLY of SuperSplat, SPZ (version 2 to 4), SOG, .splat or "
        ".ksplat.",
    )
