"""Selects and appends Gaussians of a scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.artefact.scene import Gaussians, SceneT
from fastsplat.service.scene.objects.label_evidence import rows_of
from fastsplat.service.scene.objects.objects import objects_of_rows


def gaussians_of_rows(gaussians: Gaussians, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Gaussians:
    """Selects Gaussians by mask [G] or by ids [K], which may repeat."""
    return Gaussians(**{name: array[rows] for name, array in vars(gaussians).items()})


def appended_gaussians(gaussians: Gaussians, part: Gaussians) -> Gaussians:
    """Appends Gaussians, with harmonics padded or cut to fit, and zero codes."""
    count, harmonics = len(part), gaussians.sh.shape[1]
    sh = np.zeros((count, harmonics, 3), np.float32)
    shared = min(harmonics, part.sh.shape[1])
    sh[:, :shared] = part.sh[:, :shared]
    codes = np.zeros((count, gaussians.codes.shape[1]), np.float32)  # W was not trained on the codes of `part`
    fitting = vars(replace(part, sh=sh, codes=codes))
    return Gaussians(**{name: np.concatenate([array, fitting[name]]) for name, array in vars(gaussians).items()})


def scene_of_rows(scene: SceneT, rows: NDArray[np.integer]) -> SceneT:
    """Selects the scene's Gaussians `rows`, int [K], in that order; repetitions are allowed."""
    return replace(
        scene,
        gaussians=gaussians_of_rows(scene.gaussians, rows),
        evidence=None if scene.evidence is None else rows_of(scene.evidence, rows),
        objects=objects_of_rows(scene.objects, rows),
    )
