"""Selection of the Gaussians that an edit changes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import expit

from fastsplat.service.query.objects.solid_gaussians import MIN_OPACITY
from fastsplat.service.scene.artefact.scene import F32
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.gaussian_filters import GaussianFilter
from fastsplat_contract.geometry.poses import Box
from fastsplat_contract.messages.scenes import Edit

if TYPE_CHECKING:
    from fastsplat.service.query.scene_index import SceneIndex


Rows = NDArray[np.int64]

_NEIGHBORS = 12
_ENCLOSED = 0.5
_MARGIN = 0.25


def edited_rows(index: SceneIndex, edit: Edit) -> Rows:
    """Selects the Gaussians that an edit is about, int64 [K], ascending.

    These are those of the label or objects and those they enclose: at least half of the opacity of their twelve nearest
    visible neighbors is selected. With a filter, only what it takes of the label or objects (without enclosed ones), or
    of the scene if neither is given.

    Raises:
        NotFoundError: no such label or object here.
        InvalidInputError: not exactly one of label and objects, or an invalid filter.
    """
    if edit.filter is not None:
        taken = _filtered(index, edit.filter)
        if edit.label is None and not edit.object_ids:
            return np.flatnonzero(taken)
        rows = _named_rows(index, edit)
        return rows[taken[rows]]
    rows = _named_rows(index, edit)
    gaussians = index.scene.gaussians
    if not len(rows):
        return rows
    opacities = expit(gaussians.logit_opacities.astype(np.float64))
    finite = np.isfinite(gaussians.means).all(axis=1)
    visible = np.flatnonzero(finite & (opacities >= MIN_OPACITY))
    taken = np.zeros(len(gaussians), dtype=np.bool_)
    taken[rows] = True
    around = gaussians.means[np.intersect1d(rows, visible)]
    if not len(around):
        return rows
    low, high = around.min(axis=0), around.max(axis=0)
    candidates = np.flatnonzero(_within(gaussians.means, low, high) & finite & ~taken)
    margin = _MARGIN * (high - low).max()
    visible = visible[_within(gaussians.means[visible], low - margin, high + margin)]
    count = min(_NEIGHBORS, len(visible))
    near = visible[cKDTree(gaussians.means[visible]).query(gaussians.means[candidates], k=[*range(1, count + 1)])[1]]
    shares = (opacities[near] * taken[near]).sum(axis=1) / opacities[near].sum(axis=1)
    taken[candidates[shares >= _ENCLOSED]] = True
    return np.flatnonzero(taken)


def _within(points: F32, low: F32, high: F32) -> NDArray[np.bool_]:
    return np.asarray(((points >= low) & (points <= high)).all(axis=1))


def _named_rows(index: SceneIndex, edit: Edit) -> Rows:
    label_id = edited_label(index, edit)
    return np.flatnonzero(index.labeled((label_id,)) if label_id else index.objects.rows(edit.object_ids))


def edited_label(index: SceneIndex, edit: Edit) -> int:
    """Id of the label that an edit is about; 0 if about existing objects.

    Raises:
        NotFoundError: no such label or object here.
        InvalidInputError: not exactly one of label and objects.
    """
    if (edit.label is not None) == bool(edit.object_ids):
        raise InvalidInputError(
            "an edit speaks of a label or of objects", field="label", hint="Send exactly one of label and objects."
        )
    if edit.label is None:
        index.objects.check_all(edit.object_ids)
        return 0
    label_id = index.scene.dictionary.id_of(edit.label)
    if label_id is None:
        raise NotFoundError(
            f"no label {edit.label[:80]!r} in this scene", field="label", hint="List the scene's labels."
        )
    return label_id


def _filtered(index: SceneIndex, criteria: GaussianFilter) -> NDArray[np.bool_]:
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
