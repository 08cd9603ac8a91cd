"""Edits of Gaussians: recolor, remove, move, duplicate.

Rows keep their order, so that masks of the old version can be mapped: recolor and move keep row numbers, remove closes
the gaps, duplicates are appended."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fastsplat.service.query.edits.edited_rows import Rows
from fastsplat.service.query.objects.solid_gaussians import masses
from fastsplat.service.scene.artefact.scene import F32, SH_C0, Gaussians, Objects, Scene
from fastsplat.service.scene.gaussians.scene_rows import gaussians_of_rows, scene_of_rows
from fastsplat.service.scene.objects.label_evidence import evidence_of
from fastsplat.service.scene.objects.objects import new_object_ids, object_rows, with_rows_of_no_part
from fastsplat_contract.messages.scenes import Edit

F64 = NDArray[np.float64]

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # ITU-R BT.709
_DARK = 0.1
_DIRECTIONS = 64


def remove(scene: Scene, rows: Rows) -> Scene:
    """Removes the Gaussians `rows`, int64 [K]."""
    stays = np.ones(len(scene.gaussians), dtype=np.bool_)
    stays[rows] = False
    return scene_of_rows(scene, np.flatnonzero(stays))


def move(scene: Scene, rows: Rows, edit: Edit) -> Scene:
    """Moves the Gaussians `rows`, int64 [K], by the edit's transform."""
    moved = moved_gaussians(gaussians_of_rows(scene.gaussians, rows), motion_of(edit))
    return replace(scene, gaussians=_put(scene.gaussians, rows, moved))


def duplicate(scene: Scene, rows: Rows, edit: Edit) -> Scene:
    """Appends copies of the Gaussians `rows`, int64 [K], moved by the edit's transform."""
    count = len(scene.gaussians)
    grown = scene_of_rows(scene, np.concatenate([np.arange(count), rows]))
    copies = np.arange(count, count + len(rows))
    if scene.objects is not None and grown.objects is not None:
        grown = replace(grown, objects=_copied(scene.objects, grown.objects, rows))
    moved = moved_gaussians(gaussians_of_rows(grown.gaussians, copies), motion_of(edit))
    return replace(grown, gaussians=_put(grown.gaussians, copies, moved))


def _copied(before: Objects, grown: Objects, rows: Rows) -> Objects:
    """Registers copies of objects, without parts, for the appended Gaussians `rows`."""
    membership, start = grown.membership, int(grown.membership.starts[len(before.membership)])
    copied = np.unique(object_rows(before)[rows])
    originals = [obj for obj in before.table if obj.id in copied]
    ids = new_object_ids(before, len(originals))
    new_ids = np.zeros(max((obj.id for obj in before.table), default=0) + 1, np.uint16)
    new_ids[[obj.id for obj in originals]] = ids
    # No photo shows a copy.
    copies = tuple(replace(obj, id=int(new_ids[obj.id]), proposed_in=(), missed_in=()) for obj in originals)
    labels = np.concatenate([membership.labels[:start], new_ids[membership.labels[start:]]])
    entries = np.repeat(np.arange(len(membership)), np.diff(membership.starts))
    return replace(
        before,
        table=(*before.table, *copies),
        membership=evidence_of(entries, labels, membership.counts, len(membership)),
        next_id=ids.stop,
        parts=None if before.parts is None else with_rows_of_no_part(before.parts, len(membership)),
    )


def recolor(scene: Scene, rows: Rows, edit: Edit) -> Scene:
    """Recolors by the luminance ratio of each Gaussian to the mean, in every direction.

    Shading and highlights persist. Near black, where ratios mean nothing, differences are kept."""
    part = gaussians_of_rows(scene.gaussians, rows)
    if not len(rows):
        return scene
    target = np.asarray(edit.color, dtype=np.float64)
    luminance = part.sh.astype(np.float64) @ _LUMINANCE  # [K, B], coefficients
    weights = masses(part.log_scales, part.logit_opacities)
    base = 0.5 + SH_C0 * luminance[:, 0]
    mean = float(np.average(base, weights=weights))
    gain = target / max(mean, _DARK)
    sh = luminance[:, :, None] * gain
    sh[:, 0] = (target + (base - mean)[:, None] * gain - 0.5) / SH_C0
    return replace(scene, gaussians=_put(scene.gaussians, rows, replace(part, sh=sh.astype(np.float32))))


def motion_of(edit: Edit) -> F64:
    """Transform of an edit, float64 [4, 4]."""
    assert edit.transform is not None
    return edit.transform.matrix()


def moved_gaussians(part: Gaussians, pose: F64) -> Gaussians:
    """Applies a rigid motion, float64 [4, 4], to means, quats and harmonics."""
    turn = Rotation.from_matrix(pose[:3, :3])  # the nearest rotation: the input is one to 1e-3 only
    rotation = turn.as_matrix()
    means = part.means.astype(np.float64) @ rotation.T + pose[:3, 3]
    x, y, z, w = turn.as_quat()
    return replace(
        part,
        means=means.astype(np.float32),
        quats=_multiplied((w, x, y, z), part.quats),
        sh=_rotated_harmonics(part.sh, rotation),
    )


def _multiplied(left: tuple[float, float, float, float], right: F32) -> F32:
    """Hamilton products left ⊗ right [K, 4], w x y z, keeping the lengths of `right`.

    scipy's product would lose the lengths, and refuses a length of 0."""
    w, x, y, z = left
    matrix = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return np.asarray(right.astype(np.float64) @ matrix.T, dtype=np.float32)


def _rotated_harmonics(sh: F32, rotation: F64) -> F32:
    """Rotates SH coefficients [K, B, 3]: Σ Y(d) sh' = Σ Y(Rᵀ d) sh for all d.

    Each degree is invariant under rotation. Its matrix is solved from the basis at more directions than it has
    functions, which is exact up to rounding and avoids formulas for Wigner matrices."""
    import torch

    from fastsplat.service.splatting.raster.harmonics import (
        basis,  # torch loads with the first edit that turns something
    )

    degree = round(sh.shape[1] ** 0.5) - 1
    if degree == 0:
        return sh
    steps = np.arange(_DIRECTIONS) + 0.5
    heights, angles = 1 - 2 * steps / _DIRECTIONS, np.pi * (1 + 5**0.5) * steps  # a Fibonacci sphere
    rims = np.sqrt(1 - heights**2)
    directions = np.stack([rims * np.cos(angles), rims * np.sin(angles), heights], axis=1)
    before = basis(torch.from_numpy(directions @ rotation), degree).numpy()
    after = basis(torch.from_numpy(directions), degree).numpy()
    turned = sh.astype(np.float64)
    for level in range(1, degree + 1):
        band = slice(level**2, (level + 1) ** 2)
        matrix = np.linalg.lstsq(after[:, band], before[:, band], rcond=None)[0]
        turned[:, band] = np.einsum("ab,kbc->kac", matrix, turned[:, band])
    return turned.astype(np.float32)


def _put(gaussians: Gaussians, rows: Rows, part: Gaussians) -> Gaussians:
    means, quats, sh = gaussians.means.copy(), gaussians.quats.copy(), gaussians.sh.copy()
    means[rows], quats[rows], sh[rows] = part.means, part.quats, part.sh
    return replace(gaussians, means=means, quats=quats, sh=sh)
