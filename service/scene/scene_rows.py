"""Some Gaussians of a scene, with all that is said of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.label_evidence import rows_of
from fastsplat.service.scene.things import things_of_rows
from fastsplat.service.scene.types import Gaussians, Scene


def gaussians_of_rows(gaussians: Gaussians, rows: NDArray[np.integer]) -> Gaussians:
    """The Gaussians `rows`, int [K], in that order; a row may be named twice."""
    return Gaussians(
        means=gaussians.means[rows],
        quats=gaussians.quats[rows],
        log_scales=gaussians.log_scales[rows],
        logit_opacities=gaussians.logit_opacities[rows],
        sh=gaussians.sh[rows],
        codes=gaussians.codes[rows],
    )


def scene_of_rows(scene: Scene, rows: NDArray[np.integer]) -> Scene:
    """The scene of the Gaussians `rows`, int [K], in that order; a row may be named twice."""
    return replace(
        scene,
        gaussians=gaussians_of_rows(scene.gaussians, rows),
        evidence=None if scene.evidence is None else rows_of(scene.evidence, rows),
        things=things_of_rows(scene.things, rows),
    )
