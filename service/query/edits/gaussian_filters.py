"""Filters of Gaussians by box, opacity and isolation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from fastsplat.service.scene.artefact.scene import F32
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.gaussian_filters import GaussianFilter
from fastsplat_contract.geometry.poses import Box

if TYPE_CHECKING:
    from fastsplat.service.query.scene_index import SceneIndex


def filtered(index: SceneIndex, criteria: GaussianFilter) -> NDArray[np.bool_]:
    """Selects Gaussians that meet all criteria, bool [G]; invalid ones raise InvalidInputError."""
    _check(criteria)
    gaussians = index.scene.gaussians
    taken = np.ones(len(gaussians), np.bool_)
    if criteria.box is not None:
        taken &= inside(criteria.box, gaussians.means) != criteria.outside
    if criteria.opacity_below is not None:
        taken &= expit(gaussians.logit_opacities.astype(np.float64)) < criteria.opacity_below
    if criteria.isolation_above is not None:
        taken &= index.isolation > criteria.isolation_above
    return taken


def inside(box: Box, points: F32) -> NDArray[np.bool_]:
    """Tests which finite points [K, 3] are in a box or on its surface, bool [K]."""
    pose = box.center.matrix()
    finite = np.asarray(np.isfinite(points).all(axis=1))
    points = np.where(finite[:, None], points, np.float32(0))
    along = (points.astype(np.float64) - pose[:3, 3]) @ pose[:3, :3]
    return np.asarray((np.abs(along) <= np.array(box.size) / 2).all(axis=1) & finite)


def _check(criteria: GaussianFilter) -> None:
    if criteria.box is None and criteria.opacity_below is None and criteria.isolation_above is None:
        raise InvalidInputError(
            "a filter that takes everything",
            field="filter",
            hint="Send at least one of box, opacity_below and isolation_above.",
        )
    if criteria.outside and criteria.box is None:
        raise InvalidInputError("outside of no box", field="filter.outside", hint="Send a box with it.")
    if criteria.opacity_below is not None and not 0 < criteria.opacity_below <= 1:
        raise InvalidInputError(
            f"an opacity of {criteria.opacity_below}", field="filter.opacity_below", limit="above 0, up to 1"
        )
    if criteria.isolation_above is not None and not criteria.isolation_above > 0:
        raise InvalidInputError(
            f"an isolation of {criteria.isolation_above}", field="filter.isolation_above", limit="above 0"
        )
    if criteria.box is not None and not min(criteria.box.size) > 0:
        raise InvalidInputError(
            f"a box of {tuple(criteria.box.size)}", field="filter.box.size", limit="above 0 along each axis"
        )
