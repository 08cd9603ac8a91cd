"""Locates the bulk of a splat, robust against floaters, backgrounds and Gaussians of any size."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.uploads.splat_input import load_splat
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat_contract.errors import InvalidInputError

F64 = NDArray[np.float64]

_OPAQUE = 0.1


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
    opacities = 1 / (1 + np.exp(-gaussians.logit_opacities.astype(np.float64)))
    weights = np.where(opacities >= min(_OPAQUE, float(opacities.max())), opacities, 0.0)
    means = gaussians.means.astype(np.float64)
    center = np.array([quantiles(means[:, axis], weights, [0.5])[0] for axis in range(3)])
    distances = np.linalg.norm(means - center, axis=1)
    radius = float(quantiles(distances, weights, [0.5])[0])
    if radius <= 0:
        raise InvalidInputError(
            "the Gaussians of the splat lie in one place, so that no picture can be taken of them",
            field="splat",
            hint="Send a splat of a scene.",
        )
    return Bulk(center, radius, distances <= radius, weights)


def quantiles(values: F64, weights: F64, shares: list[float]) -> F64:
    """Weighted quantiles, float64 [len(shares)]: smallest values whose cumulative weight reaches each share."""
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    places = np.searchsorted(reached, np.array(shares) * reached[-1])
    return np.asarray(values[order][np.minimum(places, len(values) - 1)])
