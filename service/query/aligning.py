"""Scenes put into another frame: Gaussians and cameras turned, scaled and shifted."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fastsplat.service.query.edits import moved_gaussians
from fastsplat.service.scene.alignment import Similarity
from fastsplat.service.scene.types import Gaussians


def placed_gaussians(gaussians: Gaussians, change: Similarity) -> Gaussians:
    """The Gaussians in another frame: they look the same to a camera that goes along (`Similarity.camera`)."""
    if change.scale == 1.0 and np.array_equal(change.rotation, np.eye(3)) and not change.translation.any():
        return gaussians
    pose = np.eye(4)
    pose[:3, :3] = change.rotation
    scaled = replace(
        gaussians,
        means=np.asarray(change.scale * gaussians.means.astype(np.float64)),
        log_scales=(gaussians.log_scales.astype(np.float64) + math.log(change.scale)).astype(np.float32),
    )
    pose[:3, 3] = change.translation
    return moved_gaussians(scaled, pose)
