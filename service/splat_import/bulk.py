"""Locates the bulk of a splat, robust against floaters, backgrounds and Gaussians of any size."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.uploads.splat_input import load_splat
from fastsplat.service.common.logistic import logistic
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat_contract.errors import InvalidInputError

F64 = NDArray[np.float64]

_OPAQUE = 0.1
_LEAST = 1e-12  # opacity, so that a splat that cannot be seen has a bulk, too


@dataclass(frozen=True)
class Bulk:
    """The bulk of a splat, with half of its visible weight."""

    center: F64  # [3], median of the visible means along each axis, weighted by opacity
    radius: float  # scene units, above 0
    core: NDArray[np.bool_]  # [G], within the radius
    weights: F64  # [G], opacities; 0 where hardly visible


def uncoded_gaussians(splat: Path) -> Gaussians:
    """Reads a capture's splat in the order of the user's file; without codes."""
    rows = load_splat(splat)
    return Gaussians(**vars(rows), codes=np.zeros((len(rows), 0), np.float32))


def find_bulk(gaussians: Gaussians) -> Bulk:
    """Finds the bulk of a splat: most small Gaussians lie where photos have detail.

    Raises:
        InvalidInputError: all Gaussians lie in one place.
    """
    opacities = np.maximum(logistic(gaussians.logit_opacities), _LEAST)
    weights = np.where(opacities >= min(_OPAQUE, float(opacities.max())), opacities, 0.0)
    means = gaussians.means.astype(np.float64)
    center = np.quantile(means, 0.5, axis=0, weights=weights, method="inverted_cdf")
    distances = np.linalg.norm(means - center, axis=1)
    radius = float(np.quantile(distances, 0.5, weights=weights, method="inverted_cdf"))
    if radius <= 0:
        raise InvalidInputError(
            "the Gaussians of the splat lie in one place, so that no picture can be taken of them",
            field="splat",
            hint="Send a splat of a scene.",
        )
    return Bulk(center, radius, distances <= radius, weights)
