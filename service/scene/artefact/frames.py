"""World frame and unit of a scene."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fastsplat.service.common.similarity import Similarity, scaled_camera
from fastsplat.service.scene.artefact.alignment import Alignment, frame_similarity
from fastsplat.service.scene.artefact.scaling import Scaling
from fastsplat.service.scene.artefact.scene import Scene


def frame_of(scene: Scene) -> Similarity:
    """Maps the trained version's frame to this version's."""
    return frame_similarity(None if scene.scaling is None else scene.scaling.meters_per_unit, scene.alignment)


def scaled(scene: Scene, scaling: Scaling) -> Scene:
    """Scales Gaussians and cameras to meters by a scaling of the trained version."""
    before = 1.0 if scene.scaling is None else scene.scaling.meters_per_unit
    factor = scaling.meters_per_unit / before
    gaussians = scene.gaussians
    means = (gaussians.means.astype(np.float64) * factor).astype(np.float32)
    log_scales = (gaussians.log_scales.astype(np.float64) + math.log(factor)).astype(np.float32)
    return replace(
        scene,
        gaussians=replace(gaussians, means=means, log_scales=log_scales),
        cameras=tuple(scaled_camera(posed, factor) for posed in scene.cameras),
        scale="METRIC",
        scaling=scaling,
        alignment=_scaled_alignment(scene.alignment, factor),
    )


def _scaled_alignment(alignment: Alignment | None, factor: float) -> Alignment | None:
    if alignment is None:
        return None
    x, y, z = alignment.translation
    return replace(
        alignment,
        translation=(x * factor, y * factor, z * factor),
        residuals=tuple(residual * factor for residual in alignment.residuals),
        rms=None if alignment.rms is None else alignment.rms * factor,
    )
